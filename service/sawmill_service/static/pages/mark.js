// A ruler or a region on the pictures, between two places in mm: how it is drawn, and what it measures.
const SVG = "http://www.w3.org/2000/svg";

export const MARKS = ["ruler", "region"];

export const lengthOf = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]);

// How far the geometry may have a length wrong, with 95 %: by the scale of the image, and by the rays at either end.
export function errorOf(length, { scalePercent, raysMm }) {
  return scalePercent === null ? null : Math.hypot((length * scalePercent) / 100, Math.SQRT2 * raysMm);
}

// The pixels whose centres lie in the ellipse between two corners: their number, mean and standard deviation.
export function statistics({ data, rows, columns }, { firstMm, pixelMm }, [a, b]) {
  const middle = [0, 1].map((axis) => (a[axis] + b[axis]) / 2);
  const half = [0, 1].map((axis) => Math.abs(a[axis] - b[axis]) / 2);
  const range = (axis, size) => [Math.max(Math.ceil((middle[axis] - half[axis] - firstMm[axis]) / pixelMm), 0),
    Math.min(Math.floor((middle[axis] + half[axis] - firstMm[axis]) / pixelMm), size - 1)];
  const [[top, bottom], [left, right]] = [range(0, rows), range(1, columns)];
  let [count, sum, squares] = [0, 0, 0];
  const away = (n, axis) => ((firstMm[axis] + n * pixelMm - middle[axis]) / half[axis]) ** 2;
  for (let row = top; row <= bottom; row += 1) {
    const down = away(row, 0);
    for (let column = left; column <= right; column += 1) {
      if (down + away(column, 1) <= 1) {
        const value = data[row * columns + column];
        [count, sum, squares] = [count + 1, sum + value, squares + value * value];
      }
    }
  }
  const mean = sum / count;
  return { count, mean, spread: Math.sqrt(Math.max(squares / count - mean * mean, 0)) };
}

// Draw a mark in an SVG element whose unit is the pixel, with its number; `place` turns mm to pixels.
export function draw(svg, mark, place, number) {
  svg.replaceChildren();
  if (!mark) {
    return;
  }
  const [a, b] = mark.ends.map(place);
  const shape = mark.kind === "ruler"
    ? { x1: a[0], y1: a[1], x2: b[0], y2: b[1] }
    : { cx: (a[0] + b[0]) / 2, cy: (a[1] + b[1]) / 2, rx: Math.abs(a[0] - b[0]) / 2, ry: Math.abs(a[1] - b[1]) / 2 };
  for (const dark of ["dark", ""]) {
    add(svg, mark.kind === "ruler" ? "line" : "ellipse", { ...shape, class: dark });
    [a, b].forEach(([cx, cy]) => add(svg, "circle", { cx, cy, r: 6, class: dark }));
  }
  add(svg, "text", { x: Math.max(a[0], b[0]) + 12, y: (a[0] > b[0] ? a : b)[1] + 6 }).textContent = number;
}

function add(svg, name, attributes) {
  const element = document.createElementNS(SVG, name);
  Object.entries(attributes).forEach(([key, value]) => element.setAttribute(key, value));
  svg.append(element);
  return element;
}
