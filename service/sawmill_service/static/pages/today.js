// Today follows the events of the service: at each it fetches its rows anew. It says so when it hears nothing.
import { showTimes, zone } from "./time.js";

const page = document.querySelector("#today");
const warning = document.querySelector("#silent");
const LOST_MS = Number(page.dataset.lostMs);
const SILENT_MS = Number(page.dataset.silentMs);
const TOGETHER_MS = 250; // events that come at once are one change of the page
const AGAIN_MS = 2000;
const heardAt = new Intl.DateTimeFormat(document.documentElement.lang === "en" ? "en-GB" : document.documentElement.lang,
  { dateStyle: "medium", timeStyle: "medium", timeZone: zone });

let number = page.dataset.after;
let stream;
let heard = Date.now(); // when the service last spoke
let lost; // since when the connection is gone
let waiting; // for more events, before the rows are fetched
let fetching; // the rows: one request at a time, so that older ones never come after newer ones
let wanted = false; // once more, for something happened since
let stale = false; // until the rows have come again
let reconnecting;
let changing; // the end of the next acknowledgement, which no event tells
const known = new Map([...page.querySelectorAll(".scanner")].map((row) => [row.id, row.outerHTML]));

function hear(event) {
  heard = Date.now();
  lost = undefined;
  number = event.lastEventId || number;
  showSilence();
}

function follow() {
  stream?.close();
  stream = new EventSource(`/v1/events?after=${number}`);
  stream.addEventListener("alive", hear);
  for (const kind of page.dataset.kinds.split(" ")) {
    stream.addEventListener(kind, (event) => {
      hear(event);
      waiting ??= setTimeout(update, TOGETHER_MS);
    });
  }
  stream.addEventListener("error", () => {
    lost ??= Date.now();
    if (stream.readyState === EventSource.CLOSED) {
      reconnect();
    }
  });
}

// A browser gives up a stream that is refused, as while the service starts, or when the key has ended.
function reconnect() {
  stream?.close();
  reconnecting ??= setTimeout(() => {
    reconnecting = undefined;
    refresh().then(look, failed).then(showSilence);
  }, AGAIN_MS);
}

function update() {
  refresh().then(showSilence, failed);
}

function failed() {
  stale = true;
  reconnect();
  showSilence();
}

function refresh() {
  clearTimeout(waiting);
  waiting = undefined;
  wanted = true;
  fetching ??= fetchWanted().finally(() => {
    fetching = undefined;
  });
  return fetching;
}

async function fetchWanted() {
  while (wanted) {
    wanted = false;
    await fetchRows();
  }
  stale = isSilent();
}

async function fetchRows() {
  const answer = await fetch(`/today/rows${location.search}`, { headers: { Accept: "text/html" }, signal: AbortSignal.timeout(SILENT_MS) });
  if (answer.redirected) {
    location.reload(); // to the login: the key has ended
    return;
  }
  if (!answer.ok) {
    throw new Error(`status ${answer.status}`);
  }
  show(new DOMParser().parseFromString(await answer.text(), "text/html").querySelector("#rows"));
}

// Only what differs is replaced, so that what has the focus keeps it and nothing moves without need.
function show(rows) {
  document.title = rows.dataset.title;
  expect(rows);
  for (const id of ["headline", "as-of"]) {
    const [old, now] = [page.querySelector(`#${id}`), rows.querySelector(`#${id}`)];
    if (id === "as-of" || old.textContent !== now.textContent) {
      old.innerHTML = now.innerHTML;
    }
  }
  const focused = where(document.activeElement);
  const board = page.querySelector("#rows");
  board.className = rows.className;
  for (const name of ["--rows", "--columns"]) {
    board.style.setProperty(name, rows.style.getPropertyValue(name));
  }
  for (const now of rows.querySelectorAll(".folded")) {
    const folded = page.querySelector(`#${now.id}`);
    folded.hidden = now.hidden;
    folded.querySelector("summary").textContent = now.querySelector("summary").textContent;
  }
  const there = new Set([...rows.querySelectorAll(".scanner")].map((each) => each.id));
  for (const row of page.querySelectorAll(".scanner")) {
    if (!there.has(row.id)) {
      row.remove();
      known.delete(row.id);
    }
  }
  for (const list of ["scanners", "grey", "fine"]) {
    showList(page.querySelector(`#${list}`), [...rows.querySelectorAll(`#${list} > .scanner`)]);
  }
  find();
  showTimes(page);
  if (focused) {
    document.getElementById(focused.row)?.querySelector(focused.part)?.focus({ preventScroll: true });
  }
}

function showList(list, rows) {
  rows.forEach((row, place) => {
    let mine = document.getElementById(row.id);
    if (mine === null || known.get(row.id) !== row.outerHTML) {
      known.set(row.id, row.outerHTML);
      const next = document.adoptNode(row);
      mine?.replaceWith(next);
      mine = next;
    }
    if (list.children[place] !== mine) {
      list.insertBefore(mine, list.children[place] ?? null);
    }
  });
}

// Only the scanners whose name has what is typed stay in sight, the fine ones too.
function find() {
  const typed = page.querySelector("#find input")?.value.trim().toLowerCase() ?? "";
  for (const row of page.querySelectorAll(".scanner")) {
    row.hidden = !row.querySelector("h2").textContent.toLowerCase().includes(typed);
  }
  if (typed) {
    page.querySelectorAll(".folded").forEach((folded) => {
      folded.open = true;
    });
  }
}

function expect(rows) {
  clearTimeout(changing);
  if (rows.dataset.changesAt) {
    const wait = new Date(rows.dataset.changesAt) - Date.now() + TOGETHER_MS;
    changing = setTimeout(update, Math.min(Math.max(wait, AGAIN_MS), 2 ** 31 - 1)); // longer waits end at once
  }
}

function where(element) {
  const row = element?.closest(".scanner");
  return row && { row: row.id, part: element.closest(".act") ? ".act a" : "h2 a" };
}

function isSilent() {
  const now = Date.now();
  return now - heard > SILENT_MS || (lost !== undefined && now - lost > LOST_MS) || !navigator.onLine;
}

// What was silent stays grey until it has new rows.
function showSilence() {
  const silent = isSilent();
  stale ||= silent;
  if (stale && !silent && !fetching && !reconnecting) {
    update();
  }
  if (stale === page.classList.contains("silent")) {
    return;
  }
  warning.querySelector("time").textContent = heardAt.format(heard);
  warning.hidden = !stale;
  page.classList.toggle("silent", stale);
}

// A page that nobody sees follows nothing: browsers allow a few connections only.
function look() {
  if (document.hidden) {
    stream?.close();
  } else if (stream === undefined || stream.readyState === EventSource.CLOSED) {
    heard = Date.now();
    follow();
  }
}

// The clock of a display on the wall.
function showClock(clock) {
  clock.textContent = new Date().toLocaleTimeString(document.documentElement.lang, { hour: "2-digit", minute: "2-digit", hourCycle: "h23", timeZone: zone });
}

const clock = page.querySelector("#clock");
if (clock) {
  showClock(clock);
  setInterval(showClock, 1000, clock);
}
// The first browser of somebody who decides for the mill sets its time zone.
if ("setsZone" in page.dataset) {
  const csrf = document.querySelector('meta[name="csrf-token"]')?.content ?? "";
  fetch("/operator/time-zone", { method: "POST", body: new URLSearchParams({ time_zone: zone, first: "yes", csrf }) })
    .catch(() => {}); // the next page sets it
}
page.querySelector("#find")?.addEventListener("input", find);
document.addEventListener("visibilitychange", look);
for (const change of ["online", "offline"]) {
  window.addEventListener(change, showSilence);
}
setInterval(showSilence, Math.min(1000, LOST_MS / 4));
expect(page.querySelector("#rows"));
look();
