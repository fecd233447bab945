// Makes keys, gives them new secrets and revokes them; a secret is shown once and kept nowhere.
import { Problem, api, enableForms } from "./api.js";
import { showTimes } from "./time.js";

const keys = document.querySelector("#keys");
const secret = document.querySelector("#secret");
const refused = document.querySelector("#refused");

async function showKeys() {
  const answer = await fetch("/system");
  if (answer.ok) {
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    keys.innerHTML = page.querySelector("#keys").innerHTML;
    showTimes(keys);
    enableForms();
  }
}

function showSecret(key) {
  secret.querySelector("h3 span").textContent = key.name;
  secret.querySelector("input").value = key.secret;
  secret.hidden = false;
  secret.scrollIntoView({ block: "center" });
  secret.querySelector("input").select();
}

function asked(form) {
  const { name, scope, expires_at: ends, display } = form.elements;
  return {
    name: name.value,
    scope: display.checked ? "read" : scope.value,
    expires_at: ends.value ? new Date(`${ends.value}T23:59:59`).toISOString() : null,
    display: display.checked,
  };
}

async function act(form) {
  if (form.matches("#make")) {
    showSecret(await api("POST", "/v1/keys", asked(form)));
    form.reset();
  } else if (form.matches(".rotate")) {
    showSecret(await api("POST", `/v1/keys/${form.dataset.key}/rotate`, { grace_s: Number(form.elements.grace_s.value) }));
  } else {
    await api("DELETE", `/v1/keys/${form.dataset.key}`);
  }
  await showKeys();
}

document.addEventListener("submit", async (event) => {
  if (!event.target.matches("#make, .rotate, .revoke")) {
    return;
  }
  event.preventDefault();
  refused.hidden = true;
  try {
    await act(event.target);
  } catch (problem) {
    if (!(problem instanceof Problem)) {
      throw problem;
    }
    refused.textContent = problem.message;
    refused.hidden = false;
  }
});
enableForms();
document.querySelector("#copy").addEventListener("click", async (event) => {
  secret.querySelector("input").select();
  await navigator.clipboard?.writeText(secret.querySelector("input").value);
  event.target.textContent = event.target.dataset.done;
});
document.querySelector("#hide").addEventListener("click", () => {
  secret.querySelector("input").value = "";
  secret.hidden = true;
});
