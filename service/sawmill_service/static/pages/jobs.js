// Keeps the page of jobs as the service has it, by what the service says that happens, and fetches a job's history when it is laid open.
import { showTimes } from "./time.js";

// After something happened; while a job runs, for its progress; and in any case.
const SOON_MS = 200, PROGRESS_MS = 2000, IDLE_MS = 10_000;
const HAPPENS = ["queued", "started", "succeeded", "failed", "cancelled", "lost", "postponed", "given-back"];
let timer;
let stream;
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
  clearTimeout(timer);
  listen();
  // Whoever is about to cancel a job must not lose the button under the finger.
  if (!document.hidden && !now.querySelector(".ask[open]")) {
    try {
      replace(await part(now.dataset.source));
      answered(true);
    } catch {
      answered(false);
    }
  }
  timer = setTimeout(refresh, now.querySelector(".job progress") ? PROGRESS_MS : IDLE_MS);
}

function soon() {
  clearTimeout(timer);
  timer = setTimeout(refresh, SOON_MS);
}

// A page that nobody sees holds no connection: browsers allow a few only. One that was refused is tried again.
function listen() {
  if (document.hidden) {
    stream?.close();
  } else if (stream === undefined || stream.readyState === EventSource.CLOSED) {
    stream = new EventSource("/v1/events");
    HAPPENS.forEach((what) => stream.addEventListener(what, soon));
  }
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
  listen();
  document.addEventListener("visibilitychange", () => {
    listen();
    soon();
  });
  timer = setTimeout(refresh, PROGRESS_MS);
}
