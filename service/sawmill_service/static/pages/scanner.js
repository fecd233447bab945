// Hours of the reader's clock, for the end of an acknowledgement.
for (const zone of document.querySelectorAll('.asked input[name="zone"]')) {
  zone.value = Intl.DateTimeFormat().resolvedOptions().timeZone;
}
// The time zone of a new schedule.
const zone = document.getElementById("time_zone");
if (zone) {
  document.getElementById("time_zones").append(...Intl.supportedValuesOf("timeZone").map((name) => new Option(name)));
  if ("here" in zone.dataset) zone.value = Intl.DateTimeFormat().resolvedOptions().timeZone;
}
