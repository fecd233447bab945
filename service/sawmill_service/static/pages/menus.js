// A menu that is open closes when something else is pressed, or by Escape.
function close(event) {
  for (const menu of document.querySelectorAll("details.more[open]")) {
    if (event.key === "Escape" || (event.type === "click" && !menu.contains(event.target))) {
      menu.open = false;
    }
  }
}

document.addEventListener("click", close);
document.addEventListener("keydown", close);
