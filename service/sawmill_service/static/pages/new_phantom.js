// Draws a phantom from rows of corners: the service draws the preview and says what is wrong.
import { Problem, api, enableForms, followJob, upload } from "./api.js";
import { numberOf, unreadable } from "./numbers.js";

const shapes = document.querySelector("#shapes");
const words = document.querySelector("#labels")?.dataset;
const BOARD = [[-100, -150], [100, -150], [100, 150], [-100, 150]];
const PAUSE_MS = 250;
let timer, asked = 0;

function copy(id) {
  return document.querySelector(`#${id}`).content.cloneNode(true);
}

function say(element, sentence) {
  element.textContent = sentence ?? "";
  element.hidden = !sentence;
}

function addCorner(body, [x, y] = ["", ""], before = null) {
  const row = copy("corner").querySelector("tr");
  row.querySelector(".x").value = x;
  row.querySelector(".y").value = y;
  body.querySelector("tbody").insertBefore(row, before);
  return row;
}

function addShape(kind, corners = []) {
  const shape = copy("shape").querySelector(".shape");
  shape.dataset.kind = kind;
  const body = shape.querySelector(".body");
  body.append(copy(kind));
  corners.forEach((corner) => addCorner(body, corner));
  shapes.append(shape);
  changed();
  return shape;
}

function number() {
  [...shapes.children].forEach((shape, place) => {
    const named = document.querySelector(`#${shape.dataset.kind}`).dataset.legend;
    shape.querySelector("legend").textContent = named.replace("{}", place + 1);
    shape.querySelector(".remove-shape").ariaLabel = words.removeShape.replace("{}", place + 1);
    shape.querySelectorAll(".corners tbody tr").forEach((row, corner) => {
      const count = corner + 1;
      row.querySelector("th").textContent = count;
      row.querySelector(".x").ariaLabel = words.x.replace("{}", count);
      row.querySelector(".y").ariaLabel = words.y.replace("{}", count);
      row.querySelector("button").ariaLabel = words.remove.replace("{}", count);
    });
  });
}

const unread = (within) => within.querySelector(".unread").innerHTML;
const value = (element) => (element.value.trim() === "" ? null : numberOf(element.value));
const point = (element) => [value(element.querySelector(".x")), value(element.querySelector(".y"))];

function drawn(shape) {
  const density = Number(shape.querySelector(".density").value);
  if (shape.dataset.kind === "disc") {
    const body = shape.querySelector(".body");
    return { kind: "disc", center_mm: point(body), radius_mm: value(body.querySelector(".radius")), density };
  }
  const corners = [...shape.querySelectorAll(".corners tbody tr")].map(point);
  return { kind: "polygon", vertices_mm: corners.filter((corner) => !corner.includes(null)), density };
}

const drawing = () => [...shapes.children].map(drawn);

async function preview() {
  const mine = ++asked;
  if (unreadable(shapes).length > 0) {
    say(document.querySelector("#together"), unread(document));
    return;
  }
  const { svg, faults } = await api("POST", "/phantoms/preview", { shapes: drawing() });
  if (mine !== asked) {
    return;
  }
  document.querySelector("#preview").innerHTML = svg ?? "";
  const sentence = (place) => faults.filter((fault) => fault.shape === place).map((fault) => fault.sentence).join(" ");
  [...shapes.children].forEach((shape, place) => say(shape.querySelector(".fault"), sentence(place)));
  say(document.querySelector("#together"), sentence(null));
}

function changed(pause = PAUSE_MS) {
  number();
  say(document.querySelector("#refused"), null);
  clearTimeout(timer);
  timer = setTimeout(() => preview().catch((problem) => say(document.querySelector("#refused"), problem.message)), pause);
}

// A comma alone stands between two numbers, as in 100,200; beside a space, a tab or a semicolon it may be a decimal one.
function cornerOf(line) {
  const apart = line.trim().split(/[\s;]+,?[\s;]*|,[\s;]+/);
  return (apart.length === 1 ? line.split(",") : apart).map(numberOf);
}

// Corners that were copied from a table: one line each, x and y.
function paste(event) {
  const row = event.target.closest(".corners tbody tr");
  const lines = event.clipboardData.getData("text").trim().split(/\r?\n/).map(cornerOf);
  if (!row || lines.length < 2 || lines.some((line) => line.length !== 2 || line.some(Number.isNaN))) {
    return;
  }
  event.preventDefault();
  lines.forEach((corner) => addCorner(row.closest(".body"), corner, row));
  row.remove();
  changed();
}

function pressed(event) {
  const button = event.target.closest("button");
  if (button?.matches(".add-corner")) {
    addCorner(button.closest(".body")).querySelector(".x").focus();
  } else if (button?.matches(".remove-corner")) {
    button.closest("tr").remove();
  } else if (button?.matches(".remove-shape")) {
    button.closest(".shape").remove();
  } else {
    return;
  }
  changed();
}

// To the scan that waits for the phantom, or to the page of the phantom, which also says why it cannot be used.
async function leave(made) {
  const back = document.querySelector(".draw").dataset.back;
  if (back && made.job_id) {
    await followJob(made.job_id, () => {});
    made = await api("GET", `/v1/phantoms/${made.id}`);
  }
  if (back && made.state === "refused") {
    throw new Problem({ detail: made.reason }, 0);
  }
  const next = new URL(back ?? `/phantoms/${made.id}`, location.href);
  if (back) {
    next.searchParams.set("phantom", made.id);
  }
  location.assign(next);
}

async function save(event) {
  event.preventDefault();
  const form = event.target, refused = document.querySelector("#refused"), [wrong] = unreadable(form);
  if (wrong) {
    say(refused, unread(form));
    wrong.focus();
    return;
  }
  try {
    const made = await api("POST", "/v1/phantoms", { name: form.elements.name.value, shapes: drawing() });
    await leave(made);
  } catch (problem) {
    if (!(problem instanceof Problem)) {
      throw problem;
    }
    say(refused, problem.message);
  }
}

async function send(event) {
  event.preventDefault();
  const form = event.target, bar = form.querySelector("progress"), refused = form.querySelector(".problem");
  const file = form.elements.file.files[0], [wrong] = unreadable(form);
  say(refused, wrong ? unread(form) : null);
  if (wrong) {
    wrong.focus();
    return;
  }
  if (file.size > Number(form.dataset.maxBytes)) {
    say(refused, form.querySelector(".too-large").innerHTML);
    return;
  }
  const query = new URLSearchParams({ name: form.elements.name.value, width_mm: numberOf(form.elements.width_mm.value) });
  bar.hidden = false;
  try {
    const phantom = await upload(`/v1/phantoms/pictures?${query}`, file, (sent, total) => (bar.value = sent / total));
    await leave(phantom);
  } catch (problem) {
    bar.hidden = true;
    say(refused, problem.message);
  }
}

if (shapes) {
  document.querySelector("#add-polygon").addEventListener("click", () => addShape("polygon", [["", ""], ["", ""], ["", ""]]));
  document.querySelector("#add-disc").addEventListener("click", () => addShape("disc"));
  shapes.addEventListener("input", () => changed());
  shapes.addEventListener("click", pressed);
  shapes.addEventListener("paste", paste);
  document.querySelector("#draw").addEventListener("submit", save);
  document.querySelector("#picture").addEventListener("submit", send);
  addShape("polygon", BOARD);
  changed(0);
  enableForms();
}
