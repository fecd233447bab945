// The answers of a form that was sent after the session had ended are in their fields again after the login. This script
// is no module: it is there before the first form is drawn, for whoever sends one while other scripts are still coming.
const KEY = "sawmill-answers";
const here = location.pathname + location.search;
const sent = JSON.parse(sessionStorage.getItem(KEY) ?? "null");
sessionStorage.removeItem(KEY);

function fill(form, answers) {
  form.closest("details")?.setAttribute("open", "");
  for (const field of form.elements) {
    const values = answers.filter(([name]) => name === field.name).map(([, value]) => value);
    if (["checkbox", "radio"].includes(field.type)) {
      field.checked = values.includes(field.value);
    } else if (field.type !== "hidden" && values.length) {
      field.value = values[0];
    }
  }
}

if (sent?.page === here && document.referrer && new URL(document.referrer).pathname === "/login") {
  document.addEventListener("DOMContentLoaded", () => {
    const form = document.querySelector(`form[method="post"][action="${CSS.escape(sent.action)}"]`);
    if (form) {
      fill(form, sent.answers);
    }
  });
}

document.addEventListener("submit", ({ target: form, defaultPrevented }) => {
  if (form.method === "post" && !defaultPrevented) {
    const answers = [...new FormData(form)].filter(([name, value]) => name !== "csrf" && typeof value === "string");
    sessionStorage.setItem(KEY, JSON.stringify({ page: here, action: form.getAttribute("action"), answers }));
  }
});
