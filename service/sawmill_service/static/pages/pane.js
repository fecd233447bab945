// One picture of the viewer: shows the newest slice that is wanted, and values at places in mm.
import { paint, roundLength } from "./painting.js";
import { Volume } from "./volume.js";

const language = document.documentElement.lang;
const written = (value, digits) => new Intl.NumberFormat(language, { maximumFractionDigits: digits }).format(value);
// A slider that has not moved for so long rests.
const REST_MS = 100;
// Pictures of these slices are loaded next, in the direction of the last move.
const AHEAD = [1, 2, -1];
const significant = new Intl.NumberFormat(language, { maximumSignificantDigits: 4 });

export class Pane {
  constructor(figure, viewer) {
    this.figure = figure;
    this.viewer = viewer;
    this.volume = new Volume(JSON.parse(figure.dataset.volume));
    this.canvas = figure.querySelector("canvas");
    [this.canvas.width, this.canvas.height] = [this.volume.columns, this.volume.rows];
    // The index of the slice on the screen and of the one that should be, and the values of the former once they are here.
    [this.shown, this.wanted, this.values] = [null, null, null];
    // The look of the picture on the screen, and the drawing of the next one.
    [this.drawn, this.drawing] = [null, null];
    this.outdated = new AbortController();
    this.pointed = [null, false];
    this.#drawScale();
  }

  slot(name) {
    return this.figure.querySelector(`[data-slot="${name}"]`);
  }

  // Show a slice, or say that there is none (null): its picture, and its values once no other slice is wanted.
  async show(index, direction) {
    Object.assign(this, { wanted: index, direction });
    this.outdated.abort();
    this.outdated = new AbortController();
    const { signal } = this.outdated;
    this.figure.querySelector(".away").hidden = index !== null;
    if (index === null) {
      this.#put(null);
      return;
    }
    try {
      this.drawing ??= this.#drawWanted().finally(() => { this.drawing = null; });
      await this.drawing;
      await new Promise((resolve) => setTimeout(resolve, REST_MS));
      if (!signal.aborted) {
        this.#put(index, await this.volume.values(index, signal));
        this.#complain("");
        this.#loadAhead(index, direction, signal).catch(() => {}); // loaded again when wanted
      }
    } catch (problem) {
      if (!signal.aborted) {
        this.#complain(problem.message);
      }
    }
  }

  // One picture is on its way at a time; of the slices wanted meanwhile, the newest is next.
  async #drawWanted() {
    while (this.wanted !== null && !this.#isDrawn()) {
      const [index, look] = [this.wanted, this.#look()];
      const picture = await this.#picture(index);
      if (this.wanted !== null) {
        this.#put(index);
        this.drawn = look;
        this.canvas.getContext("2d").drawImage(picture, 0, 0, this.canvas.width, this.canvas.height);
      }
    }
  }

  // What a picture shows: a slice, in a window and in colours. Values are painted in others when these change.
  #look() {
    return JSON.stringify([this.wanted, this.viewer.window, this.viewer.colors]);
  }

  #isDrawn() {
    return this.values ? this.shown === this.wanted : this.drawn === this.#look();
  }

  async #loadAhead(index, direction, signal) {
    for (const step of AHEAD) {
      const next = index + step * direction;
      if (next >= 0 && next < this.volume.slices) {
        await this.#picture(next, { signal, priority: "low" });
      }
    }
  }

  #picture(index, options) {
    return this.volume.picture(index, this.viewer.window, this.viewer.colors, options);
  }

  // Paint the values in the present window and colours, or draw the picture in them while there are no values.
  repaint() {
    if (this.values) {
      paint(this.canvas, this.values, this.viewer.window, this.viewer.table);
    } else if (this.wanted !== null) {
      this.show(this.wanted, this.direction);
    }
  }

  // The pixel under a pointer's event: [row, column], a row is +x and a column +y.
  pixelAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const share = [(event.clientY - box.top) / box.height, (event.clientX - box.left) / box.width];
    return [Math.floor(share[0] * this.canvas.height), Math.floor(share[1] * this.canvas.width)];
  }

  placeOf([row, column]) {
    const { firstMm, pixelMm } = this.volume;
    return [firstMm[0] + row * pixelMm, firstMm[1] + column * pixelMm];
  }

  // Say the value at (x, y) in mm; `marked` draws a cross there, where the pointer is over another picture.
  point(place, marked) {
    this.pointed = [place, marked];
    const cross = this.figure.querySelector(".cross");
    if (this.shown === null || !place) {
      cross.hidden = true;
      return;
    }
    const { firstMm, pixelMm, rows, columns, unit } = this.volume;
    const [row, column] = place.map((mm, axis) => Math.round((mm - firstMm[axis]) / pixelMm));
    const inside = row >= 0 && row < rows && column >= 0 && column < columns;
    const [x, y] = place.map((mm) => written(mm, 1));
    this.slot("place").textContent = `x ${x} mm, y ${y} mm:`;
    const value = this.values && significant.format(this.values.data[row * columns + column]);
    this.slot("value").textContent = !inside ? "–" : value === null ? "…" : `${value} ${unit}`;
    cross.hidden = !marked || !inside;
    cross.style.top = `${(100 * (row + 0.5)) / rows}%`;
    cross.style.left = `${(100 * (column + 0.5)) / columns}%`;
  }

  // A slice is on the screen, with its values once they are here; null: none is.
  #put(index, values = null) {
    Object.assign(this, { shown: index, values, drawn: null });
    this.canvas.style.visibility = index === null ? "hidden" : "visible";
    this.figure.dataset.shown = index ?? "";
    this.figure.dataset.values = values ? index : "";
    if (values) {
      this.repaint();
    }
    this.point(...this.pointed);
  }

  #drawScale() {
    const { pixelMm, columns, factor } = this.volume;
    const side = pixelMm * columns;
    const length = roundLength(side / 4);
    this.figure.querySelector(".rule").style.width = `${(100 * length) / side}%`;
    this.slot("length").textContent = `${written(length, 3)} mm`;
    const averaged = this.slot("averaged");
    averaged.textContent = factor > 1 ? averaged.dataset.text.replaceAll("{factor}", factor) : "";
  }

  #complain(sentence) {
    const problem = this.figure.querySelector(".problem");
    problem.textContent = sentence;
    problem.hidden = !sentence;
  }
}
