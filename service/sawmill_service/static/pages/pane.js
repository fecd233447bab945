// One picture of the viewer: shows the newest slice that was asked for, and values at places in mm.
import { paint, roundLength } from "./painting.js";
import { Volume } from "./volume.js";

const language = document.documentElement.lang;
const written = (value, digits) => new Intl.NumberFormat(language, { maximumFractionDigits: digits }).format(value);
const significant = new Intl.NumberFormat(language, { maximumSignificantDigits: 4 });

export class Pane {
  constructor(figure, viewer) {
    this.figure = figure;
    this.viewer = viewer;
    this.volume = new Volume(JSON.parse(figure.dataset.volume));
    this.canvas = figure.querySelector("canvas");
    this.shown = null;
    this.wanted = null;
    this.working = false;
    this.pointed = [null, false];
  }

  slot(name) {
    return this.figure.querySelector(`[data-slot="${name}"]`);
  }

  // Show a slice, or say that there is none (null). While one is on its way, only the newest wish counts.
  async show(index, direction = 1) {
    this.wanted = index;
    this.figure.querySelector(".away").hidden = index !== null;
    const here = index === null ? null : this.volume.here(index);
    if (index === null || here) {
      this.#put(here);
    }
    if (this.working) {
      return;
    }
    this.working = true;
    try {
      while (this.wanted !== null && this.shown?.index !== this.wanted) {
        const slice = await this.volume.load(this.wanted);
        if (this.wanted === slice.index) {
          this.#put(slice);
        }
      }
      this.#complain("");
    } catch (problem) {
      this.#complain(problem.message);
    } finally {
      this.working = false;
    }
    if (this.wanted === index && index !== null) {
      this.volume.loadAhead(index, direction, () => this.wanted === index).catch(() => {}); // asked for again when wanted
    }
  }

  repaint() {
    if (this.shown) {
      paint(this.canvas, this.shown, this.viewer.window, this.viewer.table);
    }
  }

  // The pixel under a pointer's event: [row, column], a row is +x and a column +y.
  pixelAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const share = [(event.clientY - box.top) / box.height, (event.clientX - box.left) / box.width];
    return [Math.floor(share[0] * this.canvas.height), Math.floor(share[1] * this.canvas.width)];
  }

  placeOf([row, column]) {
    const { firstMm, pixelMm } = this.shown;
    return [firstMm[0] + row * pixelMm, firstMm[1] + column * pixelMm];
  }

  // Say the value at (x, y) in mm; `marked` draws a cross there, where the pointer is over another picture.
  point(place, marked) {
    this.pointed = [place, marked];
    const cross = this.figure.querySelector(".cross");
    if (!this.shown || !place) {
      cross.hidden = true;
      return;
    }
    const { firstMm, pixelMm, rows, columns, data } = this.shown;
    const [row, column] = place.map((mm, axis) => Math.round((mm - firstMm[axis]) / pixelMm));
    const inside = row >= 0 && row < rows && column >= 0 && column < columns;
    const [x, y] = place.map((mm) => written(mm, 1));
    this.slot("place").textContent = `x ${x} mm, y ${y} mm:`;
    this.slot("value").textContent = inside ? `${significant.format(data[row * columns + column])} ${this.volume.unit}` : "–";
    cross.hidden = !marked || !inside;
    cross.style.top = `${(100 * (row + 0.5)) / rows}%`;
    cross.style.left = `${(100 * (column + 0.5)) / columns}%`;
  }

  #put(slice) {
    this.canvas.style.visibility = slice ? "visible" : "hidden";
    this.shown = slice ?? null;
    this.figure.dataset.shown = slice ? slice.index : "";
    if (slice) {
      this.repaint();
      this.#drawScale(slice);
      this.point(...this.pointed);
    }
  }

  #drawScale({ pixelMm, columns }) {
    const side = pixelMm * columns;
    const length = roundLength(side / 4);
    this.figure.querySelector(".rule").style.width = `${(100 * length) / side}%`;
    this.slot("length").textContent = `${written(length, 3)} mm`;
    const averaged = this.slot("averaged");
    averaged.textContent = this.volume.factor > 1 ? averaged.dataset.text.replaceAll("{factor}", this.volume.factor) : "";
  }

  #complain(sentence) {
    const problem = this.figure.querySelector(".problem");
    problem.textContent = sentence;
    problem.hidden = !sentence;
  }
}
