// The log from the side, under the slices: a line where the slice lies, and a press or drag that goes to one.
import { paint, windowOf } from "./painting.js";

// Null for a volume of an earlier version, which has no side view.
export async function navigator(element, volume, viewer, go) {
  const view = await volume.side().catch(() => null);
  if (!view || volume.slices < 2) {
    return null;
  }
  element.hidden = false;
  const [canvas, line, window] = [element.querySelector("canvas"), element.querySelector(".line-at"), windowOf(view.data)];
  // A column of the picture may stand for several slices.
  const across = view.rows * Math.ceil(volume.slices / view.rows);

  function goTo(event) {
    const box = canvas.getBoundingClientRect();
    go(Math.floor(((event.clientX - box.left) / box.width) * across));
  }

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    goTo(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) {
      goTo(event);
    }
  });
  return {
    mark(index) {
      line.style.left = `${(100 * (index + 0.5)) / across}%`;
    },
    repaint() {
      paint(canvas, view, window, viewer.table, true);
    },
  };
}
