// `/fixed-pairs`: sends the files of all pairs, one after the other, and asks for the calibration or for a log's marks.
import { Problem, api, enableForms, forgetUpload, nameOf, uploadInParts } from "./api.js";
import { numberOf } from "./numbers.js";
import { bytes, filled, language, show } from "./sending.js";

const inspections = new WeakMap(); // of files that were sent: they are not sent again after a wrong answer

function chosen(form) {
  const byName = (one, other) => one.name.localeCompare(other.name, language, { numeric: true });
  return [...form.elements.files.files].sort(byName);
}

function showOrder(form) {
  form.querySelector(".order").replaceChildren(...chosen(form).map((file) => {
    const item = document.createElement("li");
    item.textContent = file.name;
    return item;
  }));
}

// The request without the new files: as the fields say, or the earlier one whose passages are used again.
function asked(form) {
  if (form.dataset.ask) {
    return JSON.parse(form.dataset.ask);
  }
  const { places, corner_tolerance_mm: corners, phantom_id, data, handedness } = Object.fromEntries(new FormData(form));
  const scanner = JSON.parse(places);
  return { pairs: scanner.pairs, corner_tolerance_mm: numberOf(corners), phantom_id, data, handedness, inspection_ids: [] };
}

// What speaks against the files, in a sentence; null: nothing.
function wrong(words, files, request) {
  const once = Number(words.pairs), pairs = once || request.pairs.length;
  const empty = files.find((file) => file.size === 0);
  const large = files.find((file) => file.size > Number(words.maxBytes));
  if (once ? files.length !== once : files.length % pairs) {
    return filled(words.count, { pairs, files: files.length });
  }
  return empty ? filled(words.empty, { name: empty.name })
    : large ? filled(words.tooLarge, { name: large.name, size: bytes(large.size), most: bytes(Number(words.maxBytes)) }) : null;
}

async function inspection(file, onProgress, signal) {
  if (!inspections.has(file)) {
    const query = new URLSearchParams({ upload_id: await uploadInParts(file, onProgress, signal), name: nameOf(file) });
    inspections.set(file, (await api("POST", `/v1/inspections?${query}`)).id);
    forgetUpload(file);
  }
  return inspections.get(file);
}

async function send(form, signal) {
  const request = asked(form), files = chosen(form), bar = form.querySelector("progress");
  const fault = wrong(form.dataset, files, request);
  if (fault) {
    return show(form.querySelector(".problem"), fault);
  }
  for (const [number, file] of files.entries()) {
    const onProgress = (sent, total) => {
      bar.value = (number + sent / total) / files.length;
    };
    request.inspection_ids.push(await inspection(file, onProgress, signal));
  }
  location.assign(`/${form.dataset.to}/${(await api("POST", `/v1/${form.dataset.to}`, request)).id}`);
}

// Files that were sent before it was cancelled stay for a day, and nothing is said.
function sentence(form, error) {
  if (error instanceof Problem) {
    return error.message;
  }
  return error.name === "AbortError" ? "" : form.dataset.unread;
}

async function submit(event) {
  event.preventDefault();
  const form = event.target, cancelling = new AbortController(), cancel = form.querySelector(".cancel");
  cancel.onclick = () => cancelling.abort();
  const busy = (is) => {
    form.querySelector("button.primary").disabled = is;
    cancel.hidden = form.querySelector("progress").hidden = !is;
  };
  show(form.querySelector(".problem"), "");
  busy(true);
  try {
    await send(form, cancelling.signal);
  } catch (error) {
    show(form.querySelector(".problem"), sentence(form, error));
  }
  busy(false);
}

for (const form of document.querySelectorAll("form.pairs")) {
  form.elements.files.addEventListener("change", () => showOrder(form));
  form.addEventListener("submit", submit);
  showOrder(form); // files that were chosen before this script was there
}
enableForms();
