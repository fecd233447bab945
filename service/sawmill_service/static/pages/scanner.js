// The time zone of a new schedule, and that of the mill.
import { zone as here } from "./time.js";

const zone = document.getElementById("time_zone");
if (zone) {
  document.getElementById("time_zones").append(...Intl.supportedValuesOf("timeZone").map((name) => new Option(name)));
  if ("here" in zone.dataset) zone.value = here;
}
