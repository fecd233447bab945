// A display on the wall looks again each minute. While the service does not answer, the page stays and says its age.
const EVERY_MS = 60_000;
let seen = new Date();

async function lookAgain() {
  const answer = await fetch("/", { headers: { Accept: "text/html" } });
  if (answer.redirected) {
    location.reload(); // to the login: the key has ended
    return;
  }
  if (!answer.ok) {
    throw new Error(`status ${answer.status}`);
  }
  const page = new DOMParser().parseFromString(await answer.text(), "text/html");
  document.querySelector("main").replaceWith(document.adoptNode(page.querySelector("main")));
  seen = new Date();
}

function showAge(isOld) {
  const age = document.querySelector("#age");
  age.textContent = `The service does not answer: this page is of ${seen.toLocaleString()}.`;
  age.hidden = !isOld;
}

setInterval(() => lookAgain().then(() => showAge(false), () => showAge(true)), EVERY_MS);
