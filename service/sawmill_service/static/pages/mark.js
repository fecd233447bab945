// A ruler or a region in a slice, between two places in mm: how it is drawn, and what it measures.
const SVG = "http://www.w3.org/2000/svg";
const language = document.documentElement.lang;

export const MARKS = ["ruler", "region"];
// Each end lies anywhere within its pixel. The difference of two such places is below 1 - sqrt(0.05) pixels with 95 %.
const PIXELS_OF_A_LENGTH = 1 - Math.sqrt(0.05);

export const written = (value, digits) => new Intl.NumberFormat(language, { maximumFractionDigits: digits }).format(value);
export const significant = (value) => new Intl.NumberFormat(language, { maximumSignificantDigits: 4 }).format(value);
export const DECIMAL_MARK = written(0.5, 1)[1];
export const lengthOf = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]);

// How far the geometry may have a length wrong, with 95 %: by the scale of the image, and by the rays at either end.
function errorOf(length, { scalePercent, raysMm }) {
  return scalePercent === null ? null : Math.hypot((length * scalePercent) / 100, Math.SQRT2 * raysMm);
}

// What a mark measures: its number with an uncertainty and a unit, both as text, and a sentence by name with its words.
// Null for a region while its slice's values are not there.
export function measure({ kind, ends_mm: ends }, volume, values) {
  const { scalePercent, raysMm, pixelMm, unit } = volume;
  if (kind === "ruler") {
    const [length, grid] = [lengthOf(ends), PIXELS_OF_A_LENGTH * pixelMm];
    const geometry = errorOf(length, volume);
    const error = Math.hypot(geometry ?? 0, grid);
    const [inMm, share] = [(mm) => written(mm, error >= 0.1 ? 1 : 2), (mm) => written(mm, mm >= 0.1 ? 1 : 2)];
    return {
      number: length, uncertainty: error, unit: "mm", short: `${inMm(length)} ± ${inMm(error)} mm`, label: `${inMm(length)} mm`,
      sentence: geometry === null ? "unsure" : "ruler", length: inMm(length), error: inMm(error), grid: share(grid),
      geometry: share(Math.max(geometry, 0.01)), scale: written(scalePercent, 2), rays: written(raysMm, 3), pixel: written(pixelMm, 2),
    };
  }
  if (!values) {
    return null;
  }
  const { count, mean, spread } = statistics(values, volume, ends);
  const [middle, deviation] = [mean, spread].map(significant);
  return {
    number: mean, uncertainty: spread, unit, short: count ? `${middle} ± ${deviation} ${unit}` : "–", label: count ? middle : "",
    sentence: count ? "region" : "empty", mean: middle, spread: deviation, count: written(count, 0), area: written(count * pixelMm ** 2, 0),
  };
}

// The pixels whose centres lie in the ellipse between two corners: their number, mean and standard deviation.
function statistics({ data, rows, columns }, { firstMm, pixelMm }, [a, b]) {
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

// Draw a mark into an SVG element whose unit is the pixel, with its label; `place` turns mm to pixels.
export function draw(svg, mark, place, label, chosen) {
  const [a, b] = mark.ends_mm.map(place);
  const shape = mark.kind === "ruler"
    ? { x1: a[0], y1: a[1], x2: b[0], y2: b[1] }
    : { cx: (a[0] + b[0]) / 2, cy: (a[1] + b[1]) / 2, rx: Math.abs(a[0] - b[0]) / 2, ry: Math.abs(a[1] - b[1]) / 2 };
  for (const look of ["dark", chosen ? "chosen" : ""]) {
    add(svg, mark.kind === "ruler" ? "line" : "ellipse", { ...shape, class: look });
    [a, b].forEach(([cx, cy]) => add(svg, "circle", { cx, cy, r: 6, class: look }));
  }
  add(svg, "text", { x: Math.max(a[0], b[0]) + 12, y: (a[0] > b[0] ? a : b)[1] + 6 }).textContent = label;
}

function add(svg, name, attributes) {
  const element = document.createElementNS(SVG, name);
  Object.entries(attributes).forEach(([key, value]) => element.setAttribute(key, value));
  svg.append(element);
  return element;
}
