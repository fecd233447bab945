// One picture of the viewer: shows the newest slice that is wanted, and values at places in mm.
import { draw, measure, significant, written } from "./mark.js";
import { paint, roundLength } from "./painting.js";
import { Volume } from "./volume.js";

// A slider that has not moved for so long rests.
const REST_MS = 100;
// Pictures of these slices are loaded next, in the direction of the last move.
const AHEAD = [1, 2, -1];

export class Pane {
  constructor(figure, viewer) {
    this.figure = figure;
    this.viewer = viewer;
    this.volume = new Volume(JSON.parse(figure.dataset.volume));
    [this.canvas, this.stage, this.marks] = ["canvas", ".stage", ".marks"].map((name) => figure.querySelector(name));
    [this.canvas.width, this.canvas.height] = [this.volume.columns, this.volume.rows];
    // The index of the slice on the screen and of the one that should be, and the values of the former once they are here.
    [this.shown, this.wanted, this.values] = [null, null, null];
    // The look of the picture on the screen, and the drawing of the next one.
    [this.drawn, this.drawing] = [null, null];
    this.outdated = new AbortController();
    this.pointed = [null, false];
    const averaged = this.slot("averaged");
    averaged.textContent = this.volume.factor > 1 ? averaged.dataset.text.replaceAll("{factor}", this.volume.factor) : "";
    new ResizeObserver(() => this.lay()).observe(this.stage);
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
    this.figure.querySelector(".scale").hidden = index === null;
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
        this.complain("");
        this.#loadAhead(index, direction, signal).catch(() => {}); // loaded again when wanted
      }
    } catch (problem) {
      if (!signal.aborted) {
        this.complain(problem.message);
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

  // Lay the picture, the marks and the scale where the view has them.
  lay() {
    const { view } = this.viewer;
    const { clientWidth: width, clientHeight: height } = this.stage;
    this.perMm = Math.min(width, height) / view.side;
    this.toPixels = ([x, y]) => [(y - view.centre[1]) * this.perMm + width / 2, (x - view.centre[0]) * this.perMm + height / 2];
    const [[top, bottom], [left, right]] = this.volume.edges();
    const corner = this.toPixels([top, left]);
    const box = [corner[0], corner[1], (right - left) * this.perMm, (bottom - top) * this.perMm];
    ["left", "top", "width", "height"].forEach((name, n) => { this.canvas.style[name] = `${box[n]}px`; });
    const length = roundLength(width / this.perMm / 4);
    this.figure.querySelector(".rule").style.width = `${length * this.perMm}px`;
    this.slot("length").textContent = `${written(length, 3)} mm`;
    this.point(...this.pointed);
    this.#mark();
  }

  // The place in mm under a pointer: [x, y], x runs down and y to the right.
  placeAt({ clientX, clientY }) {
    const { left, top, width, height } = this.stage.getBoundingClientRect();
    const { centre } = this.viewer.view;
    return [centre[0] + (clientY - top - height / 2) / this.perMm, centre[1] + (clientX - left - width / 2) / this.perMm];
  }

  // The pixel at a place: [row, column], a row is +x and a column +y.
  pixelAt(place) {
    return place.map((mm, axis) => Math.round((mm - this.volume.firstMm[axis]) / this.volume.pixelMm));
  }

  // The middle of that pixel, in mm.
  middleAt(place) {
    return this.pixelAt(place).map((n, axis) => this.volume.firstMm[axis] + n * this.volume.pixelMm);
  }

  // Say the value at (x, y) in mm; `marked` draws a cross there, where the pointer is over another picture.
  point(place, marked) {
    this.pointed = [place, marked];
    const cross = this.figure.querySelector(".cross");
    if (this.shown === null || !place) {
      cross.hidden = true;
      return;
    }
    const { rows, columns, unit } = this.volume;
    const [row, column] = this.pixelAt(place);
    const inside = row >= 0 && row < rows && column >= 0 && column < columns;
    const [x, y] = place.map((mm) => written(mm, 1));
    this.slot("place").textContent = `x ${x} mm, y ${y} mm:`;
    const value = this.values && significant(this.values.data[row * columns + column]);
    this.slot("value").textContent = !inside ? "–" : value === null ? "…" : `${value} ${unit}`;
    cross.hidden = !marked || !inside;
    [cross.style.left, cross.style.top] = this.toPixels(place).map((pixels) => `${pixels}px`);
  }

  // Draw the rulers and the regions of the slice, and say what the chosen one measures here.
  #mark() {
    const { marks } = this.viewer;
    const shown = marks.of(this.viewer.index);
    const measured = this.slot("measured");
    measured.hidden = true;
    this.marks.replaceChildren();
    shown.forEach((mark) => {
      const isChosen = mark === marks.chosen;
      const found = measure(mark, this.volume, this.values);
      draw(this.marks, mark, this.toPixels, `${marks.numberOf(mark)}: ${found?.label ?? "…"}`, isChosen);
      if (isChosen && found) {
        measured.hidden = false;
        this.#fill(measured, found.sentence, found);
      }
    });
  }

  // Fill the sentence of this name with values.
  #fill(element, name, values) {
    const sentence = this.figure.querySelector(`template[data-sentence="${name}"]`).content.textContent;
    element.textContent = sentence.replace(/\{(\w+)\}/g, (_, key) => values[key]);
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
    this.#mark();
  }

  complain(sentence) {
    const problem = this.figure.querySelector(".problem");
    problem.textContent = sentence;
    problem.hidden = !sentence;
  }
}
