// The part of the field that the pictures show, in mm: common to all of them, so that they show the same place.
const DEEPEST = 8; // pixels across at the least

export class View {
  // Volumes whose fields are seen whole at first, and what happens after each change.
  constructor(volumes, changed) {
    const edges = volumes.map((volume) => volume.edges());
    const low = [0, 1].map((axis) => Math.min(...edges.map((each) => each[axis][0])));
    const high = [0, 1].map((axis) => Math.max(...edges.map((each) => each[axis][1])));
    this.whole = { centre: [0, 1].map((axis) => (low[axis] + high[axis]) / 2), side: Math.max(high[0] - low[0], high[1] - low[1]) };
    this.least = DEEPEST * Math.min(...volumes.map((volume) => volume.pixelMm));
    Object.assign(this, this.whole, { low, high, changed });
  }

  get zoomed() {
    return this.side < this.whole.side;
  }

  // Never beyond the whole field, and its middle never outside.
  show(centre, side) {
    this.side = this.#allowed(side);
    const within = (mm, axis) => Math.min(Math.max(mm, this.low[axis]), this.high[axis]);
    this.centre = this.zoomed ? centre.map(within) : this.whole.centre;
    this.changed();
  }

  fit() {
    this.show(this.whole.centre, this.whole.side);
  }

  // Show less by a factor below 1; the place stays where it is.
  zoom(factor, place = this.centre) {
    const side = this.#allowed(this.side * factor);
    this.show(place.map((mm, axis) => mm + ((this.centre[axis] - mm) * side) / this.side), side);
  }

  #allowed(side) {
    return Math.min(Math.max(side, this.least), this.whole.side);
  }

  moveBy(by) {
    this.show(this.centre.map((mm, axis) => mm + by[axis]), this.side);
  }

  // As three numbers of the address.
  toText() {
    return [...this.centre, this.side].map((mm) => mm.toFixed(2)).join(",");
  }
}
