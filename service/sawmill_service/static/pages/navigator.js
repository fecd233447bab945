// The log from the side, under the slices: a line where the slice lies, and a press or drag that goes to one.
import { paint, windowOf } from "./painting.js";

// Null for a volume of an earlier version, which has no side view. Of two logs, the heights of each are marked.
export async function navigator(element, volumes, viewer, go) {
  const volume = volumes[0];
  const view = await volume.side().catch(() => null);
  if (!view || volume.slices < 2) {
    return null;
  }
  element.hidden = false;
  const [canvas, line, window] = [element.querySelector("canvas"), element.querySelector(".line-at"), windowOf(view.data)];
  // A column of the picture may stand for several slices.
  const across = view.rows * Math.ceil(volume.slices / view.rows);

  const ranges = volumes.map((each) => each.range());
  if (volumes.length > 1 && ranges.every(Boolean)) {
    element.querySelectorAll(".range").forEach((bar, n) => {
      const ends = ranges[n].map((height) => (height - volume.firstHeightMm) / (volume.spacingMm ?? 1)).sort((a, b) => a - b);
      const [from, to] = [ends[0], ends[1] + 1].map((index) => Math.min(Math.max(index / across, 0), 1));
      [bar.style.left, bar.style.width, bar.hidden] = [`${100 * from}%`, `${100 * (to - from)}%`, from === to];
    });
  }

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
