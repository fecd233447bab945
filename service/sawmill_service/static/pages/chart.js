// A chart's values under the pointer and by keyboard; of a calibration, the way to it.
const chart = document.getElementById("chart");
const rows = [...document.querySelectorAll("#measurements tbody tr")];
if (chart && rows.length) {
  const heads = [...document.querySelectorAll("#measurements thead th")].map((head) => head.textContent);
  const places = rows.map((row) => Number(row.dataset.x));
  const readout = document.getElementById("readout");
  const cursor = chart.querySelector(".cursor");
  const values = chart.querySelector(".values");
  const chosen = document.getElementById("chosen");
  let at = rows.length - 1;

  // The words are the table's: its heads and its cells.
  const sentence = (row) => {
    const [when, what, ...cells] = [...row.cells].map((cell) => cell.textContent.trim());
    return [`${when}: ${what}`, ...cells.map((cell, index) => `${heads[index + 2]} ${cell}`)].join(" · ");
  };
  const show = (index) => {
    at = Math.min(Math.max(index, 0), rows.length - 1);
    const plot = values.getBoundingClientRect();
    cursor.hidden = false;
    cursor.style.left = `${plot.left - chart.getBoundingClientRect().left + (places[at] / 100) * plot.width - 1}px`;
    readout.textContent = sentence(rows[at]);
    if (chosen) {
      chosen.hidden = !rows[at].dataset.href;
      chosen.href = rows[at].dataset.href ?? "";
    }
    chart.setAttribute("aria-valuenow", at + 1);
    chart.setAttribute("aria-valuetext", readout.textContent);
  };
  const STEPS = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageUp: -10, PageDown: 10, Home: -Infinity, End: Infinity };
  chart.addEventListener("keydown", (event) => {
    if (event.key in STEPS) {
      event.preventDefault();
      show(at + STEPS[event.key]);
    }
  });
  chart.addEventListener("focus", () => chart.matches(":focus-visible") && show(at));
  const point = (event) => {
    const plot = values.getBoundingClientRect();
    const x = (100 * (event.clientX - plot.left)) / plot.width;
    const far = places.map((place) => Math.abs(place - x));
    show(far.indexOf(Math.min(...far)));
  };
  chart.addEventListener("pointermove", point);
  chart.addEventListener("pointerdown", point);
}
