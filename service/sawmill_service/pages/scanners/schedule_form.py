"""Schedules in plain words: a choice of days and a time becomes a cron expression, and such a one becomes words."""

import gettext
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sawmill_contracts.scanners import StoredScanner
from sawmill_contracts.schedules import ScheduleRequest
from sawmill_platform.due_times import time_zones
from sawmill_platform.errors import Invalid
from sawmill_service.pages.frame.languages import marked
from sawmill_store.schedules.schedules import Schedules

# Choices of days, by the weekdays of cron.
DAYS = {
    "*": marked("Every day"),
    "1-5": marked("Monday to Friday"),
    "1-6": marked("Monday to Saturday"),
    "1": marked("Every Monday"),
    "2": marked("Every Tuesday"),
    "3": marked("Every Wednesday"),
    "4": marked("Every Thursday"),
    "5": marked("Every Friday"),
    "6": marked("Every Saturday"),
    "0": marked("Every Sunday"),
}
KINDS = {
    "recalibrate": marked("Calibrate with the newest phantom scan"),
    "check-drift": marked("Check the newest log for drift"),
}
# Outcomes of a due time without a stored calibration or drift check.
OUTCOMES = {
    "queued": marked("a calibration, which was removed since"),
    "no-new-phantom-scan": marked("no new phantom scan"),
    "no-new-log-scan": marked("no new log that a drift check could use"),
    "no-active-calibration": marked("no active calibration"),
}
ON_PASS = ("report", "activate")
_PLAIN = re.compile(r"([0-5]?\d) ([01]?\d|2[0-3]) \* \* (\*|1-5|1-6|[0-6])")
_CLOCK = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)")


@dataclass
class ScheduleForm:
    """Texts of the fields of a new schedule, and what is wrong with them."""

    values: dict[str, str] = field(
        default_factory=lambda: {
            "kind": "recalibrate",
            "days": "1-5",
            "clock": "05:30",
            "time_zone": "UTC",
            "on_pass": ON_PASS[0],
            "cron": "",
        }
    )
    errors: dict[str, str] = field(default_factory=dict)


def plain(cron: str) -> tuple[str, str] | None:
    """Return the days (a text of the pages) and the time HH:MM of an expression that a choice can make, else None."""
    match = _PLAIN.fullmatch(" ".join(cron.split()))
    return None if match is None else (DAYS[match[3]], f"{int(match[2]):02}:{int(match[1]):02}")


def added(
    schedules: Schedules, scanner: StoredScanner, typed: Mapping[str, str], text: gettext.NullTranslations
) -> ScheduleForm:
    """Add the schedule that somebody typed; the form holds errors where the schedule is wrong."""
    form = ScheduleForm()
    form.values |= {name: typed.get(name, value).strip() for name, value in form.values.items()}
    zone = form.values["time_zone"][:64]
    if zone not in time_zones():
        sentence = text.gettext("must be a name of the tz database, as Europe/Helsinki or UTC, not “%(value)s”")
        form.errors["time_zone"] = sentence % {"value": zone}
    cron = form.values["cron"] or _cron_of(form, text)
    if cron is None or form.errors:
        return form
    kind: Any = form.values["kind"] if form.values["kind"] in KINDS else "recalibrate"
    on_pass: Any = form.values["on_pass"] if form.values["on_pass"] in ON_PASS else ON_PASS[0]
    if kind == "check-drift":
        on_pass = ON_PASS[0]  # the field is for calibrations
    try:
        ask = ScheduleRequest(scanner_id=scanner.id, kind=kind, cron=cron[:100], time_zone=zone, on_pass=on_pass)
        schedules.create(ask)
    except Invalid as refused:
        form.errors["cron"] = str(refused)
    return form


def _cron_of(form: ScheduleForm, text: gettext.NullTranslations) -> str | None:
    """Return the cron expression of the chosen days and time."""
    days, clock = form.values["days"], form.values["clock"]
    match = _CLOCK.fullmatch(clock)
    if days not in DAYS:
        form.errors["days"] = text.gettext("Choose the days.")
    if match is None:
        sentence = text.gettext("must be a time from 00:00 to 23:59, as in 05:30, not “%(value)s”")
        form.errors["clock"] = sentence % {"value": clock}
        return None
    return None if form.errors else f"{int(match[2])} {int(match[1])} * * {days}"
