// A phantom's page: follows its tracing, takes measurements, asks for plans.
import { Problem, api, enableForms, followJob } from "./api.js";
import { numberOf, unreadable } from "./numbers.js";

function say(form, sentence) {
  const problem = form.querySelector(".problem");
  problem.textContent = sentence ?? "";
  problem.hidden = !sentence;
}

// Runs what a form asks for; what the service refuses is said in the form.
function onSubmit(form, act) {
  form?.addEventListener("submit", async (event) => {
    event.preventDefault();
    const button = form.querySelector("button");
    const [wrong] = unreadable(form);
    say(form, wrong ? form.querySelector(".unread").innerHTML : null);
    if (wrong) {
      wrong.focus();
      return;
    }
    button.disabled = true;
    try {
      await act(form);
    } catch (problem) {
      if (!(problem instanceof Problem)) {
        throw problem;
      }
      say(form, problem.message);
    } finally {
      button.disabled = false;
    }
  });
}

const text = (form, name) => form.elements[name].value.trim() || null;
const figure = (form, name) => (text(form, name) === null ? null : numberOf(text(form, name)));

async function measure(form) {
  const shared = {
    standard_uncertainty_mm: figure(form, "standard_uncertainty_mm"),
    measured_on: text(form, "measured_on"),
    instrument: text(form, "instrument"),
    moisture_percent: figure(form, "moisture_percent"),
    expires_on: text(form, "expires_on"),
  };
  const lengths = ["x", "y"].filter((axis) => figure(form, axis) !== null);
  if (lengths.length === 0) {
    say(form, form.querySelector(".nothing").innerHTML);
    return;
  }
  const measurements = lengths.map((axis) => ({ dimension: axis, measured_mm: figure(form, axis), ...shared }));
  const newer = await api("POST", `/v1/phantoms/${form.dataset.phantom}/measurements`, { measurements });
  location.assign(`/phantoms/${newer.id}`);
}

const GEOMETRY = ["initial_angle_deg", "detector_to_cor_mm", "source_shift_mm", "detector_shift_mm", "detector_tilt_deg"];
const radians = (degrees) => (degrees * Math.PI) / 180;

function nominal(form) {
  const [angle, toCor, source, detector, tilt] = GEOMETRY.map((name) => figure(form, name));
  return {
    initial_angle_rad: radians(angle),
    detector_to_cor_mm: toCor,
    source_shift_mm: source,
    detector_shift_mm: detector,
    // Its slope.
    detector_tilt: Math.tan(radians(tilt)),
  };
}

async function plan(form) {
  const given = GEOMETRY.filter((name) => figure(form, name) !== null).length;
  if (given !== 0 && given !== GEOMETRY.length) {
    say(form, form.querySelector(".partly").innerHTML);
    return;
  }
  const asked = await api("POST", `/v1/phantoms/${form.dataset.phantom}/plans`, {
    scanner_id: text(form, "scanner_id"),
    views: figure(form, "views"),
    noise: figure(form, "noise") / 100,
    theta: given ? nominal(form) : null,
  });
  await showPlans();
  await follow(asked.job_id, form.querySelector(".waiting"));
  await showPlans();
}

async function follow(jobId, waiting) {
  const bar = waiting.querySelector("progress");
  waiting.hidden = false;
  await followJob(jobId, (job) => {
    if (job.progress) {
      bar.value = job.progress.fraction;
    }
  });
  waiting.hidden = true;
}

async function showPlans() {
  const answer = await fetch(`${location.pathname}/plans`);
  if (answer.ok) {
    document.querySelector("#plans").innerHTML = await answer.text();
  }
}

const tracing = document.querySelector("#tracing");
if (tracing) {
  follow(tracing.dataset.job, tracing).then(() => location.reload());
}
onSubmit(document.querySelector("form.measure"), measure);
const form = document.querySelector("form.plan");
if (form) {
  onSubmit(form, plan);
  const open = () => (form.querySelector(".nominal").open = form.elements.scanner_id.selectedOptions[0].dataset.calibrated === "no");
  form.elements.scanner_id.addEventListener("change", open);
  open();
  const unfinished = document.querySelector("#plans [data-job]");
  if (unfinished) {
    follow(unfinished.dataset.job, form.querySelector(".waiting")).then(showPlans);
  }
}
enableForms();
