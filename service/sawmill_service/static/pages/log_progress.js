// The progress of a log that is being computed; its slices are shown as soon as they are there.
import { followJob } from "./api.js";

const card = document.querySelector("#progress");
const slot = (name) => card.querySelector(`[data-slot="${name}"]`);
const language = document.documentElement.lang;
const stages = JSON.parse(slot("stage").dataset.words);
const percent = new Intl.NumberFormat(language, { style: "percent", maximumFractionDigits: 0 });

function duration(seconds) {
  const [value, unit] = seconds < 90 ? [seconds, "second"] : seconds < 5400 ? [seconds / 60, "minute"] : [seconds / 3600, "hour"];
  return new Intl.NumberFormat(language, { style: "unit", unit, unitDisplay: "long", maximumFractionDigits: 0 }).format(value);
}

function show(job) {
  const fraction = job.progress?.fraction ?? 0;
  card.querySelector("progress").value = fraction;
  slot("percent").textContent = percent.format(fraction);
  const stage = job.progress?.stage ?? "";
  slot("stage").textContent = stages[stage] ?? stage;
  const left = slot("left");
  const known = typeof job.seconds_left === "number";
  left.textContent = known ? left.dataset.text.replace("{time}", duration(Math.max(1, job.seconds_left))) : "";
}

followJob(card.dataset.job, show).then(() => location.reload());
