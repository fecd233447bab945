// The slices of one volume: as pictures, which come soon, and as values. The browser keeps what has come.
import { Problem } from "./api.js";

// Along a side: the service averages blocks of pixels of larger slices. A picture takes a twentieth of the bytes of
// its values, and comes within 0.3 s over 3 Mbit/s.
const MOST_PIXELS = 1024;
const MOST_PIXELS_OF_A_PICTURE = 512;

// An NPY file, version 1.0, of a two-dimensional float32 array in C order.
export function parseNpy(buffer) {
  const start = 10 + new DataView(buffer).getUint16(8, true);
  const header = new TextDecoder("latin1").decode(new Uint8Array(buffer, 10, start - 10));
  const [, rows, columns] = /'shape': \((\d+), (\d+)\)/.exec(header).map(Number);
  return { rows, columns, data: new Float32Array(buffer, start) };
}

async function load(path, options, tries = 5) {
  const answer = await fetch(path, options);
  if (answer.status === 429 && tries > 1) {
    await new Promise((resolve) => setTimeout(resolve, 1000 * Number(answer.headers.get("Retry-After") ?? 1)));
    return load(path, options, tries - 1);
  }
  if (!answer.ok) {
    throw new Problem(await answer.json().catch(() => null), answer.status);
  }
  return answer;
}

const loadArray = async (path, options) => parseNpy(await (await load(path, options)).arrayBuffer());

export class Volume {
  constructor(described) {
    Object.assign(this, described);
    const [slices, ...sides] = described.shape;
    const factor = Math.ceil(Math.max(...sides) / MOST_PIXELS);
    // Pixels as they are shown; the first one's centre is that of the block that was averaged.
    const [rows, columns] = sides.map((side) => Math.ceil(side / factor));
    const firstMm = described.firstPixelMm.map((place) => place + 0.5 * (factor - 1) * described.pixelMm);
    Object.assign(this, { slices, rows, columns, factor, firstMm, pixelMm: factor * described.pixelMm });
    this.path = `/v1/reconstructions/${this.id}`;
  }

  // The ends of the field in mm: those along x, which runs down the picture, and those along y.
  edges() {
    return [this.rows, this.columns].map((pixels, axis) => [-0.5, pixels - 0.5].map((n) => this.firstMm[axis] + n * this.pixelMm));
  }

  // Where a slice lies along the log; null where slices have no spacing.
  heightOf(index) {
    return this.firstHeightMm === null ? null : this.firstHeightMm + index * (this.spacingMm ?? 0);
  }

  // The first and the last height, or null where slices have no heights.
  range() {
    return this.firstHeightMm === null ? null : [0, this.slices - 1].map((index) => this.heightOf(index)).sort((a, b) => a - b);
  }

  // The slice at a height, or null where the log has none.
  indexAt(height) {
    const index = Math.round((height - this.firstHeightMm) / (this.spacingMm ?? 1));
    return index >= 0 && index < this.slices ? index : null;
  }

  // A slice as a picture of 8 bits a colour, in a window and a colour map.
  async picture(index, { low, high }, colors, options) {
    const drawn = { max_size: MOST_PIXELS_OF_A_PICTURE, window_low: low, window_high: high, color_map: colors };
    const answer = await load(`${this.path}/slices/${index}.jpg?${new URLSearchParams(drawn)}`, options);
    return createImageBitmap(await answer.blob());
  }

  // The values of a slice: { rows, columns, data }.
  values(index, signal) {
    return loadArray(`${this.path}/slices/${index}.npy?max_size=${MOST_PIXELS}`, { signal });
  }

  side() {
    return loadArray(`${this.path}/side.npy?along=x&max_size=1024`, {});
  }
}
