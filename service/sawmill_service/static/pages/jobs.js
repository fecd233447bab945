// Keeps the page of jobs as the service has it, and fetches a job's history when it is laid open.
import { showTimes } from "./time.js";

const NEXT_MS = 2000;
const now = document.querySelector("#now");
const silent = document.querySelector("#silent");

async function part(address) {
  const answer = await fetch(address, { headers: { Accept: "text/html" } });
  if (!answer.ok) {
    throw new Error(`status ${answer.status}`);
  }
  const held = document.createElement("template");
  held.innerHTML = await answer.text();
  return held.content;
}

// Lays open what was open, with what it had loaded, and gives the focus back.
function replace(fresh) {
  for (const open of now.querySelectorAll("details[open]")) {
    const again = fresh.getElementById(open.id);
    if (again) {
      again.querySelector(".loaded")?.replaceChildren(...open.querySelector(".loaded").childNodes);
      again.open = true;
    }
  }
  const focused = document.activeElement?.id;
  now.replaceChildren(...fresh.childNodes);
  showTimes(now);
  if (focused) {
    document.getElementById(focused)?.focus();
  }
}

async function refresh() {
  // Whoever is about to cancel a job must not lose the button under the finger.
  if (!document.hidden && !now.querySelector(".ask[open]")) {
    try {
      replace(await part(now.dataset.source));
      answered(true);
    } catch {
      answered(false);
    }
  }
  setTimeout(refresh, NEXT_MS);
}

function answered(yes) {
  silent.hidden = yes;
  now.classList.toggle("silent", !yes);
}

// The event comes too when `replace` has laid it open again: an open history stays as new as the page.
async function laidOpen(event) {
  const history = event.target;
  if (history.matches(".history[open]")) {
    try {
      history.querySelector(".loaded").replaceChildren(await part(history.dataset.source));
      showTimes(history);
    } catch {
      answered(false);
    }
  }
}

now.addEventListener("toggle", laidOpen, true);
if (now.dataset.source) {
  setTimeout(refresh, NEXT_MS);
}
