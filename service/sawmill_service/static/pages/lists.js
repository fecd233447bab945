// While something on a list is not finished, the list is looked at again.
import { showTimes } from "./time.js";

const EVERY_MS = 4000;

// A picture that is not there any more leaves an empty place.
document.addEventListener("error", (event) => {
  if (event.target.matches("img.thumbnail")) {
    const place = document.createElement("span");
    place.className = "thumbnail";
    event.target.replaceWith(place);
  }
}, true);

async function lookAgain() {
  const answer = await fetch(location.href, { headers: { Accept: "text/html" } });
  if (!answer.ok || answer.redirected) {
    return;
  }
  const page = new DOMParser().parseFromString(await answer.text(), "text/html");
  if (page.querySelector("#list[data-unfinished]")) {
    if (document.querySelector("ul.items")) {
      document.querySelector("#list").replaceWith(document.adoptNode(page.querySelector("#list")));
      showTimes();
    }
    return;
  }
  location.reload();
}

setInterval(() => {
  if (document.querySelector("#list[data-unfinished]") && !document.hidden) {
    lookAgain().catch(() => {}); // the service is away: the next look may find it
  }
}, EVERY_MS);
