// The page of a result follows what others decide about its scanner.
const { scanner, after } = document.querySelector("[data-after]").dataset;
const stream = new EventSource(`/v1/events?after=${after}&scanner_id=${scanner}`);
for (const decision of ["calibration-activated", "calibration-rolled-back", "calibration-discarded"]) {
  stream.addEventListener(decision, () => location.reload());
}
