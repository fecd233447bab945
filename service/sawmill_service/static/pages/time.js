// Times are those of the mill's time zone, or of the browser's until it is set; ages stay true while a page is open.
export const zone = document.documentElement.dataset.zone ?? Intl.DateTimeFormat().resolvedOptions().timeZone;
const language = document.documentElement.lang === "en" ? "en-GB" : document.documentElement.lang;
const moment = new Intl.DateTimeFormat(language, { dateStyle: "medium", timeStyle: "short", timeZone: zone });
const second = new Intl.DateTimeFormat(language, { dateStyle: "short", timeStyle: "medium", timeZone: zone });
const ago = new Intl.RelativeTimeFormat(language, { numeric: "auto" });
const UNITS = [["year", 31_557_600], ["month", 2_629_800], ["week", 604_800], ["day", 86_400], ["hour", 3600], ["minute", 60]];

export function age(time) {
  const seconds = (time - Date.now()) / 1000;
  const [unit, length] = UNITS.find(([, length]) => Math.abs(seconds) >= length) ?? ["second", 1];
  return ago.format(Math.trunc(seconds / length), unit);
}

export function showTimes(root = document) {
  for (const element of root.querySelectorAll("time[data-show]")) {
    const time = new Date(element.dateTime);
    const local = moment.format(time);
    element.textContent = element.dataset.show === "age" ? age(time) : local;
    element.title = local;
  }
  // An option of a list holds text alone.
  for (const option of root.querySelectorAll("option[data-moment]")) {
    const { before, after } = option.dataset;
    const written = ("seconds" in option.dataset ? second : moment).format(new Date(option.dataset.moment));
    option.textContent = `${before ? `${before} ` : ""}${written}${after ?? ""}`;
  }
}

// Days and hours that a form sends are those of the same zone.
for (const field of document.querySelectorAll('input[name="zone"]')) {
  field.value = zone;
}

showTimes();
setInterval(showTimes, 30_000);
