// The chart's values under the pointer and by keyboard, and a clock in local time.
const chart = document.getElementById("chart");
if (chart) {
  const rows = [...document.querySelectorAll("#measurements tbody tr")];
  const heads = [...document.querySelectorAll("#measurements thead th")].map((head) => head.textContent);
  const places = rows.map((row) => Number(row.dataset.x));
  const readout = document.getElementById("readout");
  const cursor = chart.querySelector(".cursor");
  const values = chart.querySelector(".values");
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

const clock = document.getElementById("clock");
if (clock) {
  const hint = document.getElementById("local-clock");
  const pattern = hint.textContent, choice = document.getElementById("days");
  const language = document.documentElement.lang === "en" ? "en-GB" : document.documentElement.lang;
  const written = new Intl.DateTimeFormat(language, { timeStyle: "short" });
  const weekday = new Intl.DateTimeFormat(language, { weekday: "long" });
  // The chosen days, as 1-5 or 0 for Sunday, by the names that they have where the browser is; every day is no other.
  const days = (utc) => choice.value.split("-").filter((day) => day !== "*").map((day) => {
    const then = new Date(utc);
    then.setUTCDate(utc.getUTCDate() + Number(day) - utc.getUTCDay());
    return weekday.format(then);
  }).join(" – ");
  const show = () => {
    const [hours, minutes] = clock.value.split(":").map(Number);
    hint.hidden = !clock.value;
    const utc = new Date();
    utc.setUTCHours(hours, minutes);
    const named = utc.getDay() === utc.getUTCDay() ? "" : days(utc);
    const words = named ? hint.dataset.otherDay.replace("{days}", named) : pattern;
    hint.textContent = clock.value ? words.replace("{clock}", written.format(utc)) : pattern;
  };
  choice.addEventListener("input", show);
  clock.addEventListener("input", show);
  show();
}
