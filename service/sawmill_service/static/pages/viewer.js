// The slice viewer: one slice of one or two logs, linked by height; its state stays in the address.
import { navigator } from "./navigator.js";
import { numberOf } from "./numbers.js";
import { GREY, colorTables } from "./painting.js";
import { Pane } from "./pane.js";

const KEYS = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10, Home: -Infinity, End: Infinity };
const WHEEL_STEP = 60; // a notch of a wheel is 100 or more, a trackpad's steps are small

const root = document.querySelector("#viewer");
const find = (selector) => root.querySelector(selector);
const [slider, low, high, colors] = ["#slice", "#low", "#high", "#colors"].map(find);
const asked = new URLSearchParams(location.search);
let tables = { grey: GREY };

const viewer = { index: Number(slider.value), window: null, colors: "grey", table: tables.grey };
const panes = [...root.querySelectorAll(".pane")].map((figure) => new Pane(figure, viewer));
const first = panes[0].volume;
const height = find('[data-slot="height"]');
const millimetres = new Intl.NumberFormat(document.documentElement.lang, { maximumFractionDigits: 1 });
const side = await navigator(find(".navigator"), first, viewer, (index) => go(index));

function go(wanted) {
  const index = Math.min(Math.max(wanted, 0), first.slices - 1);
  const direction = index < viewer.index ? -1 : 1;
  viewer.index = index;
  slider.value = index;
  find('[data-slot="number"]').textContent = index;
  const at = first.heightOf(index);
  height.textContent = at === null ? "" : `(${millimetres.format(at)} mm)`;
  panes.forEach((pane) => pane.show(pane === panes[0] ? index : linked(pane.volume, index, at), direction));
  side?.mark(index);
  changed();
}

// The slice of another log at the same height; by number where one of them has no heights.
function linked(volume, index, at) {
  return at === null || volume.firstHeightMm === null ? Math.min(index, volume.slices - 1) : volume.indexAt(at);
}

let painting = false;

function repaint() {
  if (!painting) {
    painting = true;
    requestAnimationFrame(() => {
      painting = false;
      panes.forEach((pane) => pane.repaint());
      side?.repaint();
    });
  }
}

function look(window) {
  viewer.window = window;
  // A millionth at the least: smaller ones would be written with an exponent.
  [low.value, high.value] = [window.low, window.high].map((value) => Number(Number(value.toPrecision(4)).toFixed(6)));
  judge(true);
  repaint();
  changed();
}

function judge(good) {
  [low, high].forEach((field) => field.setAttribute("aria-invalid", String(!good)));
  const problem = find("#window-problem");
  problem.textContent = good ? "" : find("#window-words").innerHTML;
  problem.hidden = good;
}

function lookByFields() {
  const window = { low: numberOf(low.value), high: numberOf(high.value) };
  const good = window.low < window.high;
  judge(good);
  if (good) {
    viewer.window = window;
    repaint();
    changed();
  }
}

function usual() {
  look({ low: first.window[0], high: first.window[1] });
}

// The other maps are asked for when one of them is chosen; while the service is away, it stays grey.
async function color(name) {
  if (!(name in tables)) {
    tables = await colorTables("/v1/color-maps").catch(() => tables);
  }
  colors.value = name in tables ? name : "grey";
  root.dataset.colors = viewer.colors = colors.value;
  viewer.table = tables[viewer.colors];
  repaint();
  changed();
}

function shownNow() {
  return { slice: viewer.index, low: viewer.window.low, high: viewer.window.high, colors: viewer.colors };
}

// The links to what is shown, and the address, when nothing has changed for a moment.
let waiting;

function changed() {
  clearTimeout(waiting);
  waiting = setTimeout(() => {
    const values = shownNow();
    for (const link of root.querySelectorAll("[data-download]")) {
      link.href = `${first.path}/${link.dataset.download.replace(/\{(\w+)\}/g, (_, name) => values[name])}`;
    }
    history.replaceState(null, "", `?${new URLSearchParams({ ...Object.fromEntries(asked), ...values })}`);
  }, 600);
}

function pointAt(pane, event) {
  const place = pane.placeOf(pane.pixelAt(event));
  panes.forEach((each) => each.point(place, each !== pane));
}

// Dragging changes the window: sideways its width, up and down its middle. A finger moving up or down scrolls the page.
function follow(pane) {
  let from = null;
  pane.canvas.addEventListener("pointerdown", (event) => {
    if (event.button === 0) {
      from = { x: event.clientX, y: event.clientY, ...viewer.window };
      pane.canvas.setPointerCapture(event.pointerId);
      pointAt(pane, event);
    }
  });
  pane.canvas.addEventListener("pointermove", (event) => {
    pointAt(pane, event);
    if (from) {
      const width = (from.high - from.low) * 2 ** ((from.x - event.clientX) / 150);
      const middle = (from.low + from.high) / 2 + ((event.clientY - from.y) / 300) * (from.high - from.low);
      look({ low: middle - width / 2, high: middle + width / 2 });
    }
  });
  for (const end of ["pointerup", "pointercancel"]) {
    pane.canvas.addEventListener(end, () => { from = null; });
  }
  pane.canvas.addEventListener("pointerleave", () => panes.forEach((each) => each.point(null)));
  let turned = 0;
  pane.canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    turned += event.deltaY;
    const steps = Math.trunc(turned / WHEEL_STEP);
    if (steps !== 0) {
      turned = 0;
      go(viewer.index + Math.sign(steps));
    }
  }, { passive: false });
}

panes.forEach(follow);
slider.addEventListener("input", () => go(slider.valueAsNumber));
root.querySelectorAll("[data-step]").forEach((button) =>
  button.addEventListener("click", () => go(viewer.index + Number(button.dataset.step))));
document.addEventListener("keydown", (event) => {
  const free = event.target === document.body || event.target.tagName === "CANVAS" || event.target === slider;
  if (free && event.key in KEYS && !event.ctrlKey && !event.altKey && !event.metaKey) {
    event.preventDefault();
    go(viewer.index + KEYS[event.key]);
  }
});
[low, high].forEach((field) => field.addEventListener("input", lookByFields));
colors.addEventListener("change", () => color(colors.value));
find("#reset").addEventListener("click", () => { usual(); color("grey"); });
// Another log beside this one, which stays as it is shown.
const beside = find(".beside");
beside?.addEventListener("change", () => beside.requestSubmit());
beside?.addEventListener("submit", (event) => {
  event.preventDefault();
  location.search = new URLSearchParams({ ...shownNow(), beside: new FormData(beside).get("beside") });
});

const given = { low: Number.parseFloat(asked.get("low")), high: Number.parseFloat(asked.get("high")) };
given.low < given.high ? look(given) : usual();
color(asked.get("colors") ?? "grey");
go(asked.has("slice") ? Number.parseInt(asked.get("slice"), 10) || 0 : viewer.index);
