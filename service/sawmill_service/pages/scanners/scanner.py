"""`/scanners/{scanner_id}`: condition, movement, newest calibration, history, schedules and settings of a scanner."""

import gettext
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Query
from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_contracts.calibrations import Provenance
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.scanners import StoredScanner
from sawmill_contracts.schedules import Schedule, ScheduleRequest, ScheduleRun
from sawmill_mill.alarms import ALARMS
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.due_times import time_zones
from sawmill_platform.errors import Invalid, NotFound
from sawmill_service.dependencies import TheStore
from sawmill_service.drawing import shown_log
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.conditional import edit_tag, precondition
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.calibrate.calibrate_words import TheWizardAddress, WizardAddress
from sawmill_service.pages.charts import DEVIATIONS, Span, drift_chart, is_calibration
from sawmill_service.pages.frame.languages import locale_of, marked
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.scanners.scanner_form import FIELDS, FOLDER, ScannerForm, ScannerForms
from sawmill_service.scanner_conditions import condition_of
from sawmill_store.calibrations import Calibrations
from sawmill_store.scans.scans import Inspections
from sawmill_store.schedules.schedules import Schedules
from sawmill_store.store import Store
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM, Theta

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


# Spans of the chart, days; twelve hours contain any shift.
SPANS = {
    0.5: marked("12 hours"),
    1: marked("1 day"),
    7: marked("1 week"),
    30: marked("30 days"),
    90: marked("90 days"),
    365: marked("1 year"),
    730: marked("2 years"),
}
SHOWN_ENTRIES, SHOWN_SCHEDULES, SHOWN_RUNS = 20, 20, 5

router = Router(include_in_schema=False, reading=Scope.READ)


@router.get("/scanners/new")
def new_scanner(page: ThePage, store: TheStore, wizard: TheWizardAddress) -> HTMLResponse:
    """Show the form for a new scanner, filled from the file that waits in the wizard if there is one."""
    return _new(page, store.inspections, wizard, _forms(page).empty())


@router.post("/scanners/new", needs=Scope.ACTIVATE, response_model=None)
def create_scanner(
    page: ThePage, store: TheStore, wizard: TheWizardAddress, typed: TheForm
) -> HTMLResponse | RedirectResponse:
    """Add a scanner and lead back to the file that waits, or show the form again with what is wrong."""
    form, spec = _forms(page).read(typed, None)
    if spec is None:
        return _new(page, store.inspections, wizard, form)
    try:
        made = store.scanners.create(spec).id
    except Invalid as refusal:
        form.errors[FOLDER] = str(refusal)
        return _new(page, store.inspections, wizard, form)
    return RedirectResponse(wizard.path(scanner=made) if wizard.inspection else f"/scanners/{made}", status_code=303)


@router.get("/scanners/{scanner_id}")
def scanner(
    scanner_id: Identifier, page: ThePage, store: TheStore, days: Annotated[float, Query(ge=0.1, le=3660)] = 90
) -> HTMLResponse:
    """Show the whole page."""
    return _answer(page, store, store.scanners.get(scanner_id), days=days)


@router.post("/scanners/{scanner_id}/settings", needs=Scope.ACTIVATE, response_model=None)
def change_settings(
    scanner_id: Identifier, page: ThePage, store: TheStore, typed: TheForm
) -> HTMLResponse | RedirectResponse:
    """Replace a scanner's description, or show the form again with what is wrong."""
    stored = store.scanners.get(scanner_id)
    form, spec = _forms(page).read(typed, stored)
    if spec is None:
        return _answer(page, store, stored, form=form)
    try:
        store.scanners.update(scanner_id, spec, check=precondition(typed.get("tag")))
    except Invalid as refusal:
        form.errors[FOLDER] = str(refusal)
    except Refused:
        _forms(page).mark_outdated(form, stored)
    if form.is_wrong:
        return _answer(page, store, stored, form=form)
    return RedirectResponse(f"/scanners/{scanner_id}#settings", status_code=303)


@router.post("/scanners/{scanner_id}/schedules", needs=Scope.ACTIVATE, response_model=None)
def add_schedule(
    scanner_id: Identifier, page: ThePage, store: TheStore, typed: TheForm
) -> HTMLResponse | RedirectResponse:
    """Add a schedule, or show the form again with what is wrong."""
    stored = store.scanners.get(scanner_id)
    form = added(store.schedules, stored, typed, page.text)
    if form.errors:
        return _answer(page, store, stored, schedule=form)
    return RedirectResponse(f"/scanners/{scanner_id}#schedules", status_code=303)


@router.post("/scanners/{scanner_id}/schedules/{schedule_id}/delete", needs=Scope.ACTIVATE)
def delete_schedule(scanner_id: Identifier, schedule_id: Identifier, store: TheStore) -> RedirectResponse:
    """Remove a schedule of the scanner."""
    if store.schedules.get(schedule_id).scanner_id != scanner_id:
        raise NotFound("schedule", schedule_id)
    store.schedules.delete(schedule_id)
    return RedirectResponse(f"/scanners/{scanner_id}#schedules", status_code=303)


def _forms(page: PageFrame) -> ScannerForms:
    return ScannerForms(locale_of(page.language), page.text)


def _new(page: PageFrame, inspections: Inspections, wizard: WizardAddress, form: ScannerForm) -> HTMLResponse:
    inspection = None if wizard.inspection is None else inspections.get(wizard.inspection)
    if inspection is not None and inspection.result is not None and inspection.result.reading is not None:
        form = _forms(page).filled(form, inspection.result.reading)
    return page.answer(
        "scanner_new.html",
        status=422 if form.is_wrong else 200,
        form=form,
        fields=FIELDS,
        wizard=wizard,
        file=None if inspection is None else inspection.options.name,
    )


def _answer(
    page: PageFrame,
    store: Store,
    stored: StoredScanner,
    *,
    days: float = 90,
    form: ScannerForm | None = None,
    schedule: ScheduleForm | None = None,
) -> HTMLResponse:
    number = store.events.reader().number
    condition, now = condition_of(store, stored), datetime.now(UTC)
    history = store.history.page(stored.id, kind=HistoryKind.ACTIVATION, limit=SHOWN_ENTRIES).items
    span = Span.until(now, days)
    movements, total = store.measurements.movements_of(stored.id, span.start, span.end)
    together = store.drift_charts.of_scanner(stored.id).charts
    active = condition.active
    radius_mm = stored.log_radius_mm or (active.radius_mm if active else LARGEST_ASSUMED_LOG_RADIUS_MM)
    status = 422 if (form and form.is_wrong) or (schedule and schedule.errors) else 200
    return page.answer(
        "scanner.html",
        status=412 if form and form.is_outdated else status,
        scanner=stored,
        tag=edit_tag(stored),
        number=number,
        condition=condition,
        alarms=ALARMS,
        active=active,
        log=None if condition.newest is None else shown_log(store.files, condition.newest.id),
        chart=drift_chart(
            movements,
            [(entry.subject_id, entry.at) for entry in history],
            span=span,
            tolerance_mm=stored.tolerances.ray_change_mm,
            total=total,
            together=together,
        ),
        together=together,
        deviations=DEVIATIONS,
        is_calibration=is_calibration,
        days=days,
        spans=SPANS,
        history=history,
        schedules=_schedules(store.calibrations, store.schedules, stored.id),
        plain=plain,
        kinds=KINDS,
        outcomes=OUTCOMES,
        day_choices=DAYS,
        schedule_form=schedule or ScheduleForm(),
        drawing=scanner_drawing(
            active.scanner if active else stored.constants, active.theta if active else stored.imported_theta, radius_mm
        ),
        made_with=_made_with(active, stored.constants),
        settings=form or _forms(page).of(stored),
        fields=FIELDS,
        editing=form is not None,
    )


def _made_with(active: Provenance | None, now: ScannerConstants) -> ScannerConstants | None:
    """Return the constants of the active calibration if others are set since; the row pitch is no part of theta."""
    if active is None or replace(active.scanner, row_pitch_mm=now.row_pitch_mm) == now:
        return None
    return active.scanner


def _schedules(
    calibrations: Calibrations, schedules: Schedules, scanner_id: str
) -> list[tuple[Schedule, list[ScheduleRun], set[str]]]:
    """Return the schedules, each with its newest outcomes and the ids of their calibrations that succeeded."""
    items = schedules.page(scanner_id=scanner_id, limit=SHOWN_SCHEDULES).items
    with_runs = [(each, schedules.runs(each.id, limit=SHOWN_RUNS)) for each in items]
    ids = {run.calibration_id for _, runs in with_runs for run in runs if run.calibration_id is not None}
    succeeded = {each.id for each in calibrations.several(ids).values() if each.state == "succeeded"}
    return [(each, runs, succeeded) for each, runs in with_runs]


Point = tuple[float, float]
MARGIN = 0.09
# Detector's distance over the source's, assumed where no calibration has found it.
ASSUMED_DETECTOR_SHARE = 0.8


@dataclass(frozen=True)
class ScannerDrawing:
    """Drawing of a scanner in mm, y downwards as in SVG, with the COR at (0, 0) and the source below it."""

    # source, detector: source, and the two ends of the detector.
    source: Point
    detector: tuple[Point, Point]
    foot: Point  # (x, y): point in which the ray through the centre of rotation meets the detector
    middle: Point  # (x, y): middle of the detector
    log_radius_mm: float  # radius of the largest log
    box: tuple[float, float, float, float]  # (left, top, width, height): box around the whole drawing
    size_mm: float  # size of a letter that can be read
    tilt_deg: float  # tilt of the detector
    calibrated: bool  # False: the detector is drawn straight, at an assumed distance


def scanner_drawing(constants: ScannerConstants, theta: Theta | None, log_radius_mm: float) -> ScannerDrawing:
    """Draw a scanner by its constants and its active calibration, at the angle of the first view.

    docs/look-up/conventions.md#theta: the source is at (h_S, -r_S), the detector's middle at (-h_D, r_D), and the
    detector's axis runs along (1, alpha_D), with y upwards.
    """
    r_s = constants.source_to_cor_mm
    drawn = theta or Theta(0.0, ASSUMED_DETECTOR_SHARE * r_s, 0.0, 0.0, 0.0)
    source, slope = (drawn.source_shift_mm, r_s), -drawn.detector_tilt
    middle = (-drawn.detector_shift_mm, -drawn.detector_to_cor_mm)
    half = 0.5 * constants.num_detector_pixels * constants.detector_pitch_mm / math.hypot(1.0, slope)
    ends = tuple((middle[0] + side * half, middle[1] + side * half * slope) for side in (-1.0, 1.0))
    radius = min(log_radius_mm, 0.9 * r_s)
    xs = [source[0], middle[0], -radius, radius, *(x for x, _ in ends)]
    ys = [source[1], -radius, radius, *(y for _, y in ends)]
    width, height = max(xs) - min(xs), max(ys) - min(ys)
    margin = MARGIN * max(width, height)
    box = (min(xs) - margin, min(ys) - margin, width + 2 * margin, height + 2 * margin)
    # t (-source) on the line of the detector, y - middle_y = slope (x - middle_x).
    s_x, s_y = source
    t = (middle[1] - slope * middle[0]) / (slope * s_x - s_y)
    return ScannerDrawing(
        source=source,
        detector=(ends[0], ends[1]),
        foot=(-t * s_x, -t * s_y),
        middle=middle,
        log_radius_mm=radius,
        box=box,
        size_mm=max(box[2], box[3]) / 24,
        tilt_deg=math.degrees(math.atan(drawn.detector_tilt)),
        calibrated=theta is not None,
    )
