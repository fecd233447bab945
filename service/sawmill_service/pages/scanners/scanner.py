"""`/scanners/{scanner_id}`: condition, movement, newest calibration, history, schedules and settings of a scanner."""

from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Query
from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_contracts.calibrations import Provenance
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.scanners import StoredScanner
from sawmill_contracts.schedules import Schedule, ScheduleRun
from sawmill_mill.alarms import ALARMS
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Invalid, NotFound
from sawmill_service.dependencies import TheCalibrations, TheInspections, TheScanners, TheSchedules, TheStore
from sawmill_service.drawing import shown_log
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.conditional import edit_tag, precondition
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.calibrate.calibrate_words import TheWizardAddress, WizardAddress
from sawmill_service.pages.charts import DEVIATIONS, Span, drift_chart, is_calibration
from sawmill_service.pages.frame.languages import locale_of, marked
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.scanners.geometry_drawing import scanner_drawing
from sawmill_service.pages.scanners.scanner_form import FIELDS, FOLDER, ScannerForm, ScannerForms
from sawmill_service.pages.scanners.schedule_form import DAYS, KINDS, OUTCOMES, ScheduleForm, added, plain
from sawmill_service.scanner_conditions import condition_of
from sawmill_store.store import Store
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM

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
def new_scanner(page: ThePage, inspections: TheInspections, wizard: TheWizardAddress) -> HTMLResponse:
    """Show the form for a new scanner, filled from the file that waits in the wizard if there is one."""
    return _new(page, inspections, wizard, _forms(page).empty())


@router.post("/scanners/new", needs=Scope.ACTIVATE, response_model=None)
def create_scanner(
    page: ThePage, scanners: TheScanners, inspections: TheInspections, wizard: TheWizardAddress, typed: TheForm
) -> HTMLResponse | RedirectResponse:
    """Add a scanner and lead back to the file that waits, or show the form again with what is wrong."""
    form, spec = _forms(page).read(typed, None)
    if spec is None:
        return _new(page, inspections, wizard, form)
    try:
        made = scanners.create(spec).id
    except Invalid as refusal:
        form.errors[FOLDER] = str(refusal)
        return _new(page, inspections, wizard, form)
    return RedirectResponse(wizard.path(scanner=made) if wizard.inspection else f"/scanners/{made}", status_code=303)


@router.get("/scanners/{scanner_id}")
def scanner(
    scanner_id: Identifier,
    page: ThePage,
    store: TheStore,
    days: Annotated[float, Query(ge=0.1, le=3660)] = 90,
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
def delete_schedule(scanner_id: Identifier, schedule_id: Identifier, schedules: TheSchedules) -> RedirectResponse:
    """Remove a schedule of the scanner."""
    if schedules.get(schedule_id).scanner_id != scanner_id:
        raise NotFound("schedule", schedule_id)
    schedules.delete(schedule_id)
    return RedirectResponse(f"/scanners/{scanner_id}#schedules", status_code=303)


def _forms(page: PageFrame) -> ScannerForms:
    return ScannerForms(locale_of(page.language), page.text)


def _new(page: PageFrame, inspections: TheInspections, wizard: WizardAddress, form: ScannerForm) -> HTMLResponse:
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
    activations = [(entry.subject_id, entry.at) for entry in history]
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
            activations,
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
            active.scanner if active else stored.constants, active.theta if active else None, radius_mm
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
    calibrations: TheCalibrations, schedules: TheSchedules, scanner_id: str
) -> list[tuple[Schedule, list[ScheduleRun], set[str]]]:
    """Return the schedules, each with its newest outcomes and the ids of their calibrations that succeeded."""
    items = schedules.page(scanner_id=scanner_id, limit=SHOWN_SCHEDULES).items
    with_runs = [(each, schedules.runs(each.id, limit=SHOWN_RUNS)) for each in items]
    ids = {run.calibration_id for _, runs in with_runs for run in runs if run.calibration_id is not None}
    succeeded = {each.id for each in calibrations.several(ids).values() if each.state == "succeeded"}
    return [(each, runs, succeeded) for each, runs in with_runs]
