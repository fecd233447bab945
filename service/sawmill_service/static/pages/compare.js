// The slider between two pictures that lie one over the other.
const compare = document.getElementById("compare");
if (compare) {
  const range = compare.querySelector("input");
  const stack = compare.querySelector(".stack");
  const show = () => stack.style.setProperty("--cut", `${range.value}%`);
  const follow = (event) => {
    const box = stack.getBoundingClientRect();
    range.value = Math.round((100 * (event.clientX - box.left)) / box.width);
    show();
  };
  compare.classList.add("live");
  range.addEventListener("input", show);
  stack.addEventListener("pointerdown", (event) => {
    stack.setPointerCapture(event.pointerId);
    follow(event);
  });
  stack.addEventListener("pointermove", (event) => event.buttons && follow(event));
  show();
}
