// A scan that somebody brings by hand: dropped anywhere on the list, it becomes a scan, from which slices are made.
import { api } from "./api.js";
import { takeFiles } from "./sending.js";

const place = document.querySelector("#bring");
if (place) {
  const answers = place.querySelector("#bring-answers");
  document.addEventListener("dragover", () => {
    place.open = true;
  });
  takeFiles(place, async (id, name) => {
    const query = new URLSearchParams({ name, upload_id: id });
    new FormData(answers).forEach((value, field) => value && query.set(field, value));
    const scan = await api("POST", `/v1/scans?${query}`);
    return `/scans/${scan.id}#reconstruct`;
  }, () => answers.reportValidity());
}
