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

// A window between two percentiles of some values, a sample of them where there are many.
export function windowOf(data) {
  const step = Math.max(1, Math.floor(data.length / 20000));
  const sample = data.filter((_, n) => n % step === 0).sort();
  const at = (share) => sample[Math.round(share * (sample.length - 1))];
  const [low, high] = [at(0.001), at(0.999)];
  return low < high ? { low, high } : { low: low - 0.5, high: low + 0.5 };
}

// The largest of 1, 2, 5 times a power of ten that is not above a length.
export function roundLength(longest) {
  const power = 10 ** Math.floor(Math.log10(longest));
  return [5, 2, 1].find((digit) => digit * power <= longest * (1 + 1e-9)) * power;
}
