// `/calibrate`: sends the file, and follows jobs until the page has something new to show.
import { AGAIN_MS, api, followJob } from "./api.js";
import { duration, filled, language, show, takeFiles } from "./sending.js";

// Fields of the questions, and the parameters of the address that have their answers.
const ANSWERS = { scanner_id: "scanner", phantom_id: "phantom", data: "data", angles_deg: "angles" };
const LONGEST_ANSWER = 2000;

async function follow(step) {
  const words = step.dataset;
  const stage = step.querySelector("#follow-stage");
  const bar = step.querySelector("#follow-bar");
  const stages = words.stages ? JSON.parse(words.stages) : null;

  function showJob(job) {
    if (!stages) {
      return;
    }
    const progress = job.progress;
    if (job.state === "queued") {
      stage.textContent = job.queue_position ? filled(words.position, { number: job.queue_position }) : words.queued;
      bar.removeAttribute("value");
    } else if (progress) {
      const now = stages[progress.stage] ?? progress.stage;
      if (stage.textContent !== now) {
        stage.textContent = now;
      }
      bar.value = progress.fraction;
    }
    const more = [];
    if (job.seconds_left !== null) {
      more.push(filled(words.left, { left: duration(job.seconds_left, words) }));
    }
    if (progress && progress.best_value !== null) {
      more.push(filled(words.best, { value: progress.best_value.toPrecision(3) }));
    }
    step.querySelector("#follow-more").textContent = more.join(", ");
  }

  // The scan's job may run beside the calibration's; that one decides when there is something new.
  const [last, ...earlier] = words.jobs.split(" ").reverse();
  let before = earlier.length > 0;
  Promise.all(earlier.map((id) => followJob(id, showJob))).then(() => {
    before = false;
  });
  await followJob(last, (job) => before || showJob(job));
  location.reload();
}

function cancelByButton(button) {
  button.addEventListener("click", async () => {
    button.disabled = true;
    try {
      await api("POST", `/v1/jobs/${button.dataset.cancel}/cancel`);
    } catch (error) {
      show(document.querySelector("#follow-problem"), error.message);
      button.disabled = false;
    }
  });
}

// Sending it twice would start two searches. A page that is gone back to is the same one: its button works again.
function sendOnce(form) {
  const button = form.querySelector("button.primary");
  form.addEventListener("submit", () => {
    button.disabled = true;
  });
  window.addEventListener("pageshow", () => {
    button.disabled = false;
  });
}

// A watched folder sends the scan: the page goes on when one of a phantom was read, or could not be; the folder also
// sends logs.
function waitForScan(waiting) {
  const { scanner, events, after } = waiting.dataset;
  const stream = new EventSource(`/v1/events?${new URLSearchParams({ scanner_id: scanner, after })}`);
  stream.addEventListener("alive", (alive) => {
    waiting.dataset.after = alive.lastEventId;
  });
  events.split(" ").forEach((kind) => stream.addEventListener(kind, async (event) => {
    waiting.dataset.after = event.lastEventId;
    const scan = await api("GET", `/v1/scans/${JSON.parse(event.data).subject_id}`);
    if (scan.phantom_id && document.querySelector("#sending").hidden) {
      location.assign(`/calibrate?${new URLSearchParams({ scanner, scan: scan.id })}`);
    }
  }));
  // A browser gives up a stream that is refused, as while the service starts, or when the session has ended.
  async function again() {
    try {
      await api("GET", `/v1/scanners/${scanner}`);
      waitForScan(waiting);
    } catch (problem) {
      if (problem.status === 401) {
        location.reload(); // to the login
      } else {
        setTimeout(again, AGAIN_MS);
      }
    }
  }
  stream.addEventListener("error", () => stream.readyState === EventSource.CLOSED && setTimeout(again, AGAIN_MS));
}

// Who makes a scanner or a phantom for the file finds the other answers again: they go with the address.
function carryAnswers(link) {
  link.addEventListener("click", () => {
    const to = new URL(link.href), form = new FormData(link.closest("form"));
    for (const [field, parameter] of Object.entries(ANSWERS)) {
      const answer = form.get(field);
      if (answer && answer.length <= LONGEST_ANSWER) {
        to.searchParams.set(parameter, answer);
      }
    }
    link.href = to;
  });
}

function searchChoices(choices) {
  const search = choices.querySelector("[type=search]");
  if (!search) {
    return;
  }
  search.closest("label").hidden = false;
  search.addEventListener("input", () => {
    const sought = search.value.trim().toLocaleLowerCase(language);
    choices.querySelector("details")?.toggleAttribute("open", sought !== "");
    for (const choice of choices.querySelectorAll(".choice")) {
      choice.hidden = !choice.textContent.toLocaleLowerCase(language).includes(sought);
    }
  });
  search.addEventListener("keydown", (event) => event.key === "Enter" && event.preventDefault()); // it sends no form
}

function enlarge(button) {
  const labels = [button.ariaLabel, button.dataset.enlarge];
  const show = (large) => {
    button.classList.toggle("enlarged", large);
    button.ariaLabel = labels[Number(large)];
  };
  button.addEventListener("click", () => show(!button.classList.contains("enlarged")));
  button.addEventListener("keydown", (event) => event.key === "Escape" && show(false));
}

const fileStep = document.querySelector("#file-step");
const followed = document.querySelector("#follow");
if (fileStep) {
  takeFiles(fileStep, async (id, name) => {
    const inspection = await api("POST", `/v1/inspections?${new URLSearchParams({ name, upload_id: id })}`);
    const next = new URL(fileStep.dataset.next, location.href);
    next.searchParams.set("inspection", inspection.id);
    return next;
  });
}
if (followed) {
  follow(followed);
}
document.querySelectorAll("#waiting").forEach(waitForScan);
document.querySelectorAll("[data-answered]").forEach(carryAnswers);
document.querySelectorAll("[data-searched]").forEach(searchChoices);
document.querySelectorAll("[data-enlarge]").forEach(enlarge);
document.querySelectorAll("[data-cancel]").forEach(cancelByButton);
document.querySelectorAll("form[action^='/calibrate']").forEach(sendOnce);
