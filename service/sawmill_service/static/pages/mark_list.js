// The rulers and regions of a log: their list, which the service keeps with the log, and its file for spreadsheets.
import { api } from "./api.js";
import { DECIMAL_MARK, measure } from "./mark.js";

const COLUMNS = ["number", "kind", "slice", "height_mm", "x1_mm", "y1_mm", "x2_mm", "y2_mm", "value", "uncertainty", "unit", "note"];

export class MarkList {
  // `go(slice)` shows a slice; `changed()` is called when other marks are to be drawn.
  constructor(root, volume, { go, changed }) {
    Object.assign(this, { root, volume, go, changed, chosen: null });
    this.keeps = "keeps" in root.dataset;
    this.all = JSON.parse(root.dataset.marks).map((mark) => ({ ...mark, isKept: true }));
    this.rows = new Map();
    this.sent = Promise.resolve();
    root.querySelector('[data-slot="save"]').addEventListener("click", () => this.#save());
    this.list();
  }

  of(slice) {
    return this.all.filter((mark) => mark.slice === slice && !mark.removed);
  }

  // The number by which people call a mark.
  numberOf(mark) {
    return this.all.indexOf(mark) + 1;
  }

  byId(id) {
    return this.all.find((mark) => mark.id === id && !mark.removed);
  }

  choose(mark) {
    this.chosen = mark ?? null;
    this.list();
    this.changed();
  }

  add(kind, slice, ends) {
    const id = [...crypto.getRandomValues(new Uint8Array(8))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
    const mark = { id, kind, slice, ends_mm: ends, note: null, isDraft: true };
    this.all.push(mark);
    return mark;
  }

  forget(mark) {
    this.all.splice(this.all.indexOf(mark), 1);
  }

  // One request after the other, so that the last change is the one that stays.
  keep(mark, sends = this.keeps) {
    Object.assign(mark, { isDraft: false, measured: null, failed: false });
    this.list();
    if (sends) {
      const path = `${this.volume.path}/marks/${mark.id}`;
      const { kind, slice, ends_mm, note, removed } = mark;
      this.sent = this.sent.then(() => (removed ? api("DELETE", path) : api("PUT", path, { kind, slice, ends_mm, note })))
        .then(() => {
          mark.isKept = !removed;
          this.#tell(mark, "");
        }, (problem) => this.#tell(mark, problem.message));
    }
  }

  // Show what others have kept, changed and removed since.
  async refresh() {
    await this.sent;
    const { marks } = await api("GET", this.volume.path);
    const [known, ids] = [new Map(this.all.map((mark) => [mark.id, mark])), marks.map(({ id }) => id)];
    const others = this.all.filter((mark) => !mark.isKept && !ids.includes(mark.id));
    const kept = marks.map((mark) => Object.assign(known.get(mark.id) ?? {}, mark, { isKept: true, measured: null }));
    this.all = [...kept, ...others];
    kept.forEach((mark) => {
      const note = this.#row(mark).querySelector('[data-slot="note"]:not(:focus)');
      note && (note.value = mark.note ?? "");
    });
    this.choose(this.byId(this.chosen?.id));
  }

  #tell(mark, sentence) {
    const problem = this.#row(mark).querySelector(".problem");
    [problem.textContent, problem.hidden] = [sentence, !sentence];
  }

  #row(mark) {
    if (!this.rows.has(mark)) {
      const row = this.root.querySelector("template").content.firstElementChild.cloneNode(true);
      const [go, note, remove] = ["go", "note", "remove"].map((name) => row.querySelector(`[data-slot="${name}"]`));
      go.addEventListener("click", () => {
        this.go(mark.slice);
        this.choose(mark);
      });
      note.value = mark.note ?? "";
      note.addEventListener("change", () => {
        mark.note = note.value.trim() || null;
        this.keep(mark);
      });
      remove.addEventListener("click", () => {
        mark.removed = !mark.removed;
        this.keep(mark);
        this.choose(mark.removed ? null : mark);
      });
      this.rows.set(mark, row);
    }
    return this.rows.get(mark);
  }

  // What is measured where; the values of a region that was not on the screen are fetched.
  list() {
    const list = this.root.querySelector("ol");
    const listed = this.all.filter((mark) => !mark.isDraft);
    listed.forEach((mark) => {
      const row = this.#row(mark);
      const remove = row.querySelector('[data-slot="remove"]');
      mark.measured ??= measure(mark, this.volume, null);
      this.#write(mark);
      remove.textContent = mark.removed ? remove.dataset.undo : "✕";
      remove.setAttribute("aria-label", mark.removed ? remove.dataset.undo : remove.dataset.remove);
      row.classList.toggle("removed", Boolean(mark.removed));
    });
    const rows = listed.map((mark) => this.#row(mark));
    if (rows.some((row, n) => list.children[n] !== row) || list.children.length !== rows.length) {
      list.replaceChildren(...rows);
    }
    this.root.hidden = rows.length === 0;
    this.measuring ??= this.#measureRegions().finally(() => { this.measuring = null; });
  }

  #write(mark) {
    const go = this.#row(mark).querySelector('[data-slot="go"]');
    const words = { number: this.numberOf(mark), slice: mark.slice, value: mark.measured?.short ?? "…" };
    go.textContent = this.root.dataset.text.replace(/\{(\w+)\}/g, (_, name) => words[name]);
    go.setAttribute("aria-current", String(mark === this.chosen));
  }

  async #measureRegions() {
    for (let mark; (mark = this.all.find((each) => !each.isDraft && !each.measured && !each.failed));) {
      const { ends_mm: ends } = mark;
      const values = await this.volume.values(mark.slice).catch(() => null);
      mark.failed = !values;
      if (mark.ends_mm === ends && values) {
        mark.measured = measure(mark, this.volume, values);
        this.#write(mark);
      }
    }
  }

  // With decimal commas and semicolons where the language has them, as its spreadsheets read it.
  #save() {
    const number = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(8))).replace(".", DECIMAL_MARK) : "");
    const lines = this.all.filter((mark) => !mark.removed && !mark.isDraft).map((mark) => [
      this.numberOf(mark), mark.kind, mark.slice, number(this.volume.heightOf(mark.slice) ?? NaN), ...mark.ends_mm.flat().map(number),
      number(mark.measured?.number), number(mark.measured?.uncertainty), mark.measured?.unit ?? "",
      (mark.note ?? "").replace(/^[=+@-]/, "'$&"), // no formula
    ]);
    const cell = (value) => `"${String(value).replaceAll('"', '""')}"`;
    const text = [COLUMNS, ...lines].map((line) => line.map(cell).join(DECIMAL_MARK === "," ? ";" : ",")).join("\r\n");
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(["\ufeff", text], { type: "text/csv" }));
    link.download = this.root.dataset.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  }
}
