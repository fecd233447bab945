// A key is long: whoever types it may see it.
const key = document.querySelector("#key");
document.querySelector("#show").addEventListener("change", (event) => {
  key.type = event.target.checked ? "text" : "password";
  key.focus();
});
