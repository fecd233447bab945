// The slice viewer: one slice of one or two logs, linked by height; its state stays in the address.
import { gestures } from "./gestures.js";
import { DECIMAL_MARK, MARKS, lengthOf } from "./mark.js";
import { MarkList } from "./mark_list.js";
import { navigator } from "./navigator.js";
import { numberOf } from "./numbers.js";
import { GREY, colorTables, woodWindows } from "./painting.js";
import { Pane } from "./pane.js";
import { View } from "./view.js";

const KEYS = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10, Home: -Infinity, End: Infinity };
const STEP = 1.5; // of the zoom's buttons and keys
const SHORTEST_PX = 5; // of a mark: shorter ones were a tap
const GRASP_PX = 28; // near an end of a mark, a finger takes hold of it
const SWIPE_PX = 60;

const root = document.querySelector("#viewer");
const find = (selector) => root.querySelector(selector);
const [slider, low, high, colors] = ["#slice", "#low", "#high", "#colors"].map(find);
const asked = new URLSearchParams(location.search);
let tables = { grey: GREY };

const viewer = { index: Number(slider.value), window: null, colors: "grey", table: tables.grey, tool: "" };
viewer.marks = { of: () => [], chosen: null }; // until the list is there
const panes = [...root.querySelectorAll(".pane")].map((figure) => new Pane(figure, viewer));
const first = panes[0].volume;
viewer.view = new View(panes.map((pane) => pane.volume), () => {
  root.toggleAttribute("data-zoomed", viewer.view.zoomed);
  lay();
});
const marks = viewer.marks = new MarkList(find("#marks"), first, { go, changed: lay });
const height = find('[data-slot="height"]');
const millimetres = new Intl.NumberFormat(document.documentElement.lang, { maximumFractionDigits: 1 });
const side = await navigator(find(".navigator"), panes.map((pane) => pane.volume), viewer, (index) => go(index));

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
  [low.value, high.value] = [window.low, window.high]
    .map((value) => String(Number(Number(value.toPrecision(4)).toFixed(6))).replace(".", DECIMAL_MARK));
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

// The nearest slice to the present one at whose height the other log has one too; null where they share no height.
function nearestCommon() {
  const away = [...Array(first.slices).keys()].sort((a, b) => Math.abs(a - viewer.index) - Math.abs(b - viewer.index));
  return away.find((index) => linked(panes[1].volume, index, first.heightOf(index)) !== null) ?? null;
}

function lay() {
  if (viewer.window) {
    panes.forEach((pane) => pane.lay());
    changed();
  }
}

// A chosen tool takes hold of the picture; without one, a finger scrolls the page and a mouse changes the window.
function choose(tool) {
  root.dataset.tool = viewer.tool = tool;
  root.querySelectorAll("[data-tool-choice]").forEach((button) =>
    button.setAttribute("aria-pressed", String(button.dataset.toolChoice === tool)));
}

async function preset(name) {
  const middle = await first.values(Math.floor(first.slices / 2)).catch((problem) => panes[0].complain(problem.message));
  middle && look(woodWindows(middle.data)[name]);
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
  const { view } = viewer;
  const { chosen, keeps } = marks;
  return {
    slice: viewer.index, low: viewer.window.low, high: viewer.window.high, colors: viewer.colors,
    ...(view.zoomed ? { view: view.toText() } : {}),
    ...(chosen && (keeps ? { mark: chosen.id } : { [chosen.kind]: chosen.ends_mm.flat().map((mm) => mm.toFixed(2)).join(",") })),
  };
}

// What the address says of a part of the view: as many numbers, or null.
function numbersAsked(name, count) {
  const numbers = (asked.get(name) ?? "").split(",").map(Number.parseFloat);
  return numbers.length === count && numbers.every(Number.isFinite) ? numbers : null;
}

// The links to what is shown, and the address, when nothing has changed for a moment.
let waiting;

function changed() {
  clearTimeout(waiting);
  waiting = setTimeout(() => {
    const values = shownNow();
    for (const link of root.querySelectorAll("[data-download]")) {
      link.href = `${first.path}/${link.dataset.download.replace(/\{(\w+)\}/g, (_, name) => values[name])}`;
      link.download = (link.dataset.name ?? "").replace("{slice}", values.slice);
    }
    const other = asked.has("beside") ? { beside: asked.get("beside") } : {};
    history.replaceState(null, "", `?${new URLSearchParams({ ...other, ...values })}`);
  }, 600);
}

function pointAt(pane, event) {
  const place = pane.middleAt(pane.placeAt(event));
  panes.forEach((each) => each.point(place, each !== pane));
}

// Dragging changes the window (sideways its width, up and down its middle), moves the picture, or draws a mark.
function dragging(pane, from) {
  const at = pane.placeAt(from);
  const pixelsOf = (ends) => lengthOf(ends) * pane.perMm;
  if (viewer.tool === "move" || from.button === 1) {
    return { drag: (event) => hold(pane, at, event) };
  }
  if (MARKS.includes(viewer.tool)) {
    return marking(at, pixelsOf, (event) => pane.placeAt(event));
  }
  if (!viewer.tool && from.pointerType === "touch") {
    let aside = 0;
    return {
      drag(event) { aside = event.clientX - from.clientX; },
      end: () => Math.abs(aside) > SWIPE_PX && go(viewer.index - Math.sign(aside)),
    };
  }
  const window = { ...viewer.window };
  return { drag(event) {
    const width = (window.high - window.low) * 2 ** ((from.clientX - event.clientX) / 150);
    const middle = (window.low + window.high) / 2 + ((event.clientY - from.clientY) / 300) * (window.high - window.low);
    look({ low: middle - width / 2, high: middle + width / 2 });
  } };
}

// Draw a new mark, or move an end of one that is near.
function marking(at, pixelsOf, placeOf) {
  const ends = marks.of(viewer.index).filter(({ kind }) => kind === viewer.tool)
    .flatMap((mark) => mark.ends_mm.map((end, n) => ({ mark, away: pixelsOf([end, at]), fixed: mark.ends_mm[1 - n] })));
  const near = ends.filter(({ away }) => away < GRASP_PX).sort((a, b) => a.away - b.away)[0];
  const mark = near?.mark ?? marks.add(viewer.tool, viewer.index, [at, at]);
  const before = mark.ends_mm;
  marks.choose(mark);
  return {
    drag(event) {
      mark.ends_mm = [near?.fixed ?? at, placeOf(event)];
      lay();
    },
    end() {
      if (pixelsOf(mark.ends_mm) >= SHORTEST_PX) {
        mark.ends_mm !== before && marks.keep(mark);
      } else if (near) {
        mark.ends_mm = before;
      } else {
        marks.forget(mark);
        marks.choose(null);
      }
      lay();
    },
  };
}

// Move the picture so that a place lies under a pointer.
function hold(pane, place, point) {
  const under = pane.placeAt(point);
  viewer.view.moveBy(place.map((mm, axis) => mm - under[axis]));
}

function follow(pane) {
  let doing = null;
  gestures(pane.stage, {
    point: (event) => pointAt(pane, event),
    leave: () => panes.forEach((each) => each.point(null)),
    begin(event) { doing = dragging(pane, event); },
    drag: (event) => doing?.drag(event),
    end() {
      doing?.end?.();
      doing = null;
    },
    pinch(before, now) {
      const place = pane.placeAt(before.middle);
      viewer.view.zoom(before.apart / now.apart, place);
      hold(pane, place, now.middle);
    },
    twice: () => viewer.view.fit(),
    turn: (step) => go(viewer.index + step),
    zoom: (event, factor) => viewer.view.zoom(factor, pane.placeAt(event)),
  });
}

function fullScreen() {
  document.fullscreenElement ? document.exitFullscreen() : root.requestFullscreen();
}

const COMMANDS = {
  "+": () => viewer.view.zoom(1 / STEP), "-": () => viewer.view.zoom(STEP), 0: () => viewer.view.fit(), f: fullScreen,
  c: () => choose("contrast"), v: () => choose("move"), m: () => choose("ruler"), r: () => choose("region"),
  1: () => preset("wood"), 2: () => preset("knots"), Escape: () => marks.choose(null),
};

panes.forEach(follow);
slider.addEventListener("input", () => go(slider.valueAsNumber));
root.querySelectorAll("[data-step]").forEach((button) =>
  button.addEventListener("click", () => go(viewer.index + Number(button.dataset.step))));
document.addEventListener("keydown", (event) => {
  const free = event.target === document.body || event.target.tagName === "CANVAS" || event.target === slider;
  if (free && event.key in KEYS && !event.ctrlKey && !event.altKey && !event.metaKey) {
    event.preventDefault();
    go(viewer.index + KEYS[event.key]);
  } else if (free && event.key in COMMANDS && !event.ctrlKey && !event.altKey && !event.metaKey) {
    event.preventDefault();
    COMMANDS[event.key]();
  }
});
root.querySelectorAll("[data-tool-choice]").forEach((button) => 
  button.addEventListener("click", () => choose(viewer.tool === button.dataset.toolChoice ? "" : button.dataset.toolChoice)));
root.querySelectorAll("[data-command]").forEach((button) => button.addEventListener("click", () => COMMANDS[button.dataset.command]()));
find('[data-command="f"]').hidden = !document.fullscreenEnabled;
root.querySelectorAll(".common").forEach((button) => {
  button.hidden = nearestCommon() === null;
  button.addEventListener("click", () => go(nearestCommon()));
});
[low, high].forEach((field) => field.addEventListener("input", lookByFields));
colors.addEventListener("change", () => color(colors.value));
find("#reset").addEventListener("click", () => { usual(); color("grey"); marks.choose(null); viewer.view.fit(); });
// Another window may have changed the list.
document.addEventListener("visibilitychange", () => document.hidden || marks.refresh().catch(() => {}));
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
const [x, y, across] = numbersAsked("view", 3) ?? [];
across > 0 ? viewer.view.show([x, y], across) : viewer.view.fit();
go(asked.has("slice") ? Number.parseInt(asked.get("slice"), 10) || 0 : viewer.index);
const kind = MARKS.find((name) => numbersAsked(name, 4));
if (kind) {
  const ends = numbersAsked(kind, 4);
  const mark = marks.add(kind, viewer.index, [ends.slice(0, 2), ends.slice(2)]);
  marks.keep(mark, false);
  marks.choose(mark);
} else {
  marks.choose(marks.byId(asked.get("mark")));
}
if (panes.length > 1 && panes[1].wanted === null) {
  go(nearestCommon() ?? viewer.index);
}
