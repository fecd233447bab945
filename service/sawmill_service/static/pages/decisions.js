// A page with a result follows what others decide about its scanner, unless a form elsewhere on it is being filled in.
const followed = document.querySelector("[data-after]");
const { scanner, after } = followed.dataset;
let stream;

function follow() {
  if ([...document.querySelectorAll("details[open] form")].every((form) => followed.contains(form))) {
    location.reload();
  } else {
    document.addEventListener("toggle", follow, { capture: true, once: true });
  }
}

// A page that nobody sees follows nothing: browsers allow a few connections only.
function look() {
  stream?.close();
  if (!document.hidden) {
    stream = new EventSource(`/v1/events?after=${after}&scanner_id=${scanner}`);
    for (const decision of ["calibration-activated", "calibration-rolled-back", "calibration-discarded", "red-acknowledged"]) {
      stream.addEventListener(decision, follow);
    }
  }
}

document.addEventListener("visibilitychange", look);
look();
