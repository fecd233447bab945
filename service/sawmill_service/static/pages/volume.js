// The slices of one volume: read as arrays, the last ones kept, neighbours fetched ahead.
import { Problem } from "./api.js";

// Of the slices that are kept, and along a side: larger slices are averaged by the service.
const MOST_BYTES = 96 * 2 ** 20;
const MOST_PIXELS = 1024;
const AHEAD = [1, 2, -1];

// An NPY file, version 1.0, of a two-dimensional float32 array in C order.
export function parseNpy(buffer) {
  const start = 10 + new DataView(buffer).getUint16(8, true);
  const header = new TextDecoder("latin1").decode(new Uint8Array(buffer, 10, start - 10));
  const [, rows, columns] = /'shape': \((\d+), (\d+)\)/.exec(header).map(Number);
  return { rows, columns, data: new Float32Array(buffer, start) };
}

async function fetchArray(path, options, tries = 5) {
  const answer = await fetch(path, options);
  if (answer.status === 429 && tries > 1) {
    await new Promise((resolve) => setTimeout(resolve, 1000 * Number(answer.headers.get("Retry-After") ?? 1)));
    return fetchArray(path, options, tries - 1);
  }
  if (!answer.ok) {
    throw new Problem(await answer.json().catch(() => null), answer.status);
  }
  return { ...parseNpy(await answer.arrayBuffer()), headers: answer.headers };
}

export class Volume {
  constructor(described) {
    Object.assign(this, described);
    [this.slices, this.rows, this.columns] = described.shape;
    this.path = `/v1/reconstructions/${this.id}`;
    this.factor = Math.ceil(Math.max(this.rows, this.columns) / MOST_PIXELS);
    this.kept = new Map();
    this.coming = new Map();
  }

  // Where a slice lies along the log; null where slices have no spacing.
  heightOf(index) {
    return this.firstHeightMm === null ? null : this.firstHeightMm + index * (this.spacingMm ?? 0);
  }

  // The slice at a height, or null where the log has none.
  indexAt(height) {
    const index = Math.round((height - this.firstHeightMm) / (this.spacingMm ?? 1));
    return index >= 0 && index < this.slices ? index : null;
  }

  // A slice that is here already.
  here(index) {
    return this.kept.get(index);
  }

  // A slice, once it is here.
  load(index, priority = "high") {
    const kept = this.kept.get(index);
    if (kept) {
      this.kept.delete(index); // the newest stands last
      this.kept.set(index, kept);
      return Promise.resolve(kept);
    }
    if (!this.coming.has(index)) {
      this.coming.set(index, this.#fetch(index, priority).finally(() => this.coming.delete(index)));
    }
    return this.coming.get(index);
  }

  // Fetch what will be looked at next, as long as `wanted()` holds.
  async loadAhead(index, direction, wanted) {
    for (const step of AHEAD) {
      const next = index + step * direction;
      if (next >= 0 && next < this.slices && wanted()) {
        await this.load(next, "low");
      }
    }
  }

  side() {
    return fetchArray(`${this.path}/side.npy?along=x&max_size=1024`, {});
  }

  async #fetch(index, priority) {
    const array = await fetchArray(`${this.path}/slices/${index}.npy?max_size=${MOST_PIXELS}`, { priority });
    const slice = {
      ...array,
      index,
      pixelMm: Number(array.headers.get("X-Pixel-Mm")),
      firstMm: array.headers.get("X-First-Pixel-Mm").split(",").map(Number),
    };
    this.kept.set(index, slice);
    const most = Math.max(4, Math.floor(MOST_BYTES / slice.data.byteLength));
    for (const oldest of [...this.kept.keys()].slice(0, Math.max(0, this.kept.size - most))) {
      this.kept.delete(oldest);
    }
    return slice;
  }
}
