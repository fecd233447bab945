// A place for a file: chosen or dropped, sent in parts with its progress, and handed to the page.
import { forgetUpload, nameOf, uploadInParts } from "./api.js";

export const language = document.documentElement.lang === "en" ? "en-GB" : document.documentElement.lang;
const UNITS = ["B", "KiB", "MiB", "GiB", "TiB"];

export function filled(text, values) {
  return text.replace(/\{(\w+)\}/g, (whole, name) => values[name] ?? whole);
}

function number(value, digits = 0) {
  return new Intl.NumberFormat(language, { minimumFractionDigits: digits, maximumFractionDigits: digits }).format(value);
}

export function bytes(value) {
  const step = Math.min(UNITS.length - 1, Math.max(0, Math.floor(Math.log2(Math.max(value, 1)) / 10)));
  return `${number(value / 1024 ** step, step ? 1 : 0)} ${UNITS[step]}`;
}

export function duration(seconds, words) {
  return seconds > 90
    ? filled(words.minutes, { number: number(Math.ceil(seconds / 60)) })
    : filled(words.seconds, { number: number(Math.ceil(seconds)) });
}

export function show(element, text) {
  element.textContent = text;
  element.hidden = !text;
}

// `accepted` gets the upload's id and the file's name, and answers with the address of the next page; `ready` may say
// that something is to be answered first.
export function takeFiles(step, accepted, ready = () => true) {
  const words = step.dataset;
  const drop = step.querySelector("#drop");
  const input = step.querySelector("#file");
  const sending = step.querySelector("#sending");
  const problem = step.querySelector("#file-problem");
  let cancelling;

  async function send(file) {
    show(problem, "");
    if (!ready()) {
      input.value = "";
      return;
    }
    if (file.size === 0) {
      show(problem, filled(words.empty, { name: file.name }));
      return;
    }
    if (file.size > Number(words.maxBytes)) {
      const most = bytes(Number(words.maxBytes));
      show(problem, filled(words.tooLarge, { name: file.name, size: bytes(file.size), most }));
      return;
    }
    cancelling = new AbortController();
    const begun = performance.now();
    step.querySelector("#sending-name").textContent = file.name;
    drop.hidden = true;
    sending.hidden = false;
    step.querySelector("#sending-cancel").focus();
    try {
      const id = await uploadInParts(file, (sent, total, connected) => {
        step.querySelector("#sending-bar").value = sent / total;
        const seconds = (performance.now() - begun) / 1000;
        const left = seconds > 1 && sent > 0 ? duration((seconds * (total - sent)) / sent, words) : "";
        const text = !connected ? words.waiting : filled(left ? words.left : words.sent, { sent: bytes(sent), total: bytes(total), left });
        step.querySelector("#sending-words").textContent = text;
      }, cancelling.signal);
      const next = await accepted(id, nameOf(file));
      forgetUpload(file);
      location.assign(next);
    } catch (error) {
      const unreachable = error.code === "unreachable";
      show(problem, error.name === "AbortError" ? words.cancelled : unreachable ? words.unreachable : error.message);
      step.querySelector("#login").hidden = error.status !== 401;
      drop.hidden = false;
      sending.hidden = true;
      input.value = "";
      input.focus();
    }
  }

  const sendChosen = () => input.files.length && send(input.files[0]);
  input.addEventListener("change", sendChosen);
  step.querySelector("#sending-cancel").addEventListener("click", () => cancelling.abort());
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      drop.classList.add("over");
    });
  }
  document.addEventListener("dragleave", (event) => event.relatedTarget || drop.classList.remove("over"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    if (event.dataTransfer.files.length && sending.hidden) {
      send(event.dataTransfer.files[0]);
    }
  });
  sendChosen(); // before this script was there
}
