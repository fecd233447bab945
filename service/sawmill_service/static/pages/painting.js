// Values to pixels: a window and a table of 256 colours, as the service's pictures have them.

// A pixel of a canvas: red, green, blue and opaque, little-endian.
const pixel = ([red, green, blue]) => ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;

// From black to white: shown before the service has sent its other maps.
export const GREY = Uint32Array.from({ length: 256 }, (_, step) => pixel([step, step, step]));

// The service's colour maps.
export async function colorTables(path) {
  const answer = await fetch(path);
  if (!answer.ok) {
    throw new Error(`status ${answer.status}`);
  }
  const maps = await answer.json();
  const pixels = (colors) => Uint32Array.from(colors, pixel);
  return Object.fromEntries(Object.entries(maps).map(([name, colors]) => [name, pixels(colors)]));
}

// Paint an array's values, a row of it as a row of the canvas, or as a column where `turned`.
export function paint(canvas, { data, rows, columns }, { low, high }, table, turned = false) {
  const [width, height] = turned ? [rows, columns] : [columns, rows];
  if (canvas.width !== width || canvas.height !== height) {
    [canvas.width, canvas.height] = [width, height];
  }
  const context = canvas.getContext("2d");
  const image = context.createImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const scale = 255 / (high - low);
  for (let n = 0; n < data.length; n += 1) {
    const step = (data[n] - low) * scale;
    const color = table[step <= 0 ? 0 : step >= 255 ? 255 : Math.floor(step + 0.5)];
    pixels[turned ? (n % columns) * rows + Math.floor(n / columns) : n] = color;
  }
  context.putImageData(image, 0, 0);
}

// Percentiles of some values, of a sample of them where there are many.
function percentiles(data) {
  const step = Math.max(1, Math.floor(data.length / 20000));
  const sample = data.filter((_, n) => n % step === 0).sort();
  return (share) => sample[Math.round(share * (sample.length - 1))];
}

const open = (low, high) => (low < high ? { low, high } : { low: low - 0.5, high: low + 0.5 });

// A window between two percentiles of some values.
export function windowOf(data) {
  const at = percentiles(data);
  return open(at(0.001), at(0.999));
}

// Windows for a slice: all of the wood, and the part of it that is denser than its middle, as knots are. Metal is too
// little of a slice to count.
export function woodWindows(data) {
  const air = 0.4 * percentiles(data)(0.95);
  const at = percentiles(data.filter((value) => value > air));
  const [light, dense] = [at(0.05), at(0.95)];
  const top = dense + 0.5 * (dense - light);
  return { wood: open(2 * light - dense, top), knots: open(0.5 * (light + dense), top) };
}

// The largest of 1, 2, 5 times a power of ten that is not above a length.
export function roundLength(longest) {
  const power = 10 ** Math.floor(Math.log10(longest));
  return [5, 2, 1].find((digit) => digit * power <= longest * (1 + 1e-9)) * power;
}
