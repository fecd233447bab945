"""`/calibrate`: from a file to the accepted calibration; the address alone determines the step.

Without parameters the page takes a file; with `inspection` it asks for what that file does not say; with
`calibration` it follows the search and then shows the result; with `scan` it asks about a scan that was sent before.
In addition to other parameters, `inspection` is where "other answers" leads back to, and `scan` has the answers that
were given before.
"""

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlencode

from fastapi import Query
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from pydantic import ValidationError

from sawmill_contracts import job_kinds
from sawmill_contracts.calibrations import CalibrationAsk, CalibrationSucceeded, CalibrationUnfinished
from sawmill_contracts.inspections import Inspection, InspectionOptions
from sawmill_contracts.scans import Scan, ScanSpec, ScanState
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict, NotFound, QueueFull, StorageError
from sawmill_service.dependencies import TheFiles, TheScans, TheSettings, TheStore, TheWake
from sawmill_service.drawing import shown_log
from sawmill_service.finished import scan_if_kept
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import STATUS, complaint
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.calibrate.calibrate_questions import questions_of, usable_phantoms
from sawmill_service.pages.calibrate.calibrate_words import advice_for, changes_of, parameters_of, stages
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.scanner_conditions import condition_of
from sawmill_store.store import Store

CALIBRATE = "/calibrate"
# Fields of a scan for which the form asks.
ASKED = ("scanner_id", "phantom_id", "data", "angles_deg")

# The form with an angle for each view: as many characters as a scan may have there, its commas as %2C.
FORM_BYTES = 400_000

router = Router(include_in_schema=False, reading=Scope.READ)


class _Answers(Given, ScanSpec):
    """Answers of the form about the scan: texts, as in a query."""

    phantom_id: Identifier


@dataclass(frozen=True)
class PageAddress:
    """Parameters in the page's address."""

    scanner: str | None = None
    inspection: str | None = None
    calibration: str | None = None
    scan: str | None = None

    def path(self, **changes: str | None) -> str:
        """Return the address with some parameters changed."""
        names = {name: value for name, value in (vars(self) | changes).items() if value}
        return f"{CALIBRATE}?{urlencode(names)}" if names else CALIBRATE


@router.get(CALIBRATE)
def calibrate(
    page: ThePage,
    store: TheStore,
    settings: TheSettings,
    scanner: Annotated[Identifier | None, Query()] = None,
    inspection: Annotated[Identifier | None, Query()] = None,
    calibration: Annotated[Identifier | None, Query()] = None,
    scan: Annotated[Identifier | None, Query()] = None,
) -> HTMLResponse:
    """Show the step between the file and the accepted calibration that the address names."""
    where = PageAddress(scanner, inspection, calibration, scan)
    if calibration is not None:
        return _of_calibration(page, store, where, store.calibrations.get(calibration))
    if inspection is not None:
        return _of_inspection(page, store, where, store.inspections.get(inspection))
    if scan is not None:
        return _of_scan(page, store, where, scan)
    scanners = store.scanners.page(limit=200).items
    return page.answer(
        "calibrate_file.html",
        where=where,
        scanners=scanners,
        chosen=next((each for each in scanners if each.id == scanner), None),
        max_bytes=settings.max_upload_bytes,
    )


@router.post(CALIBRATE, needs=Scope.SUBMIT, max_form_bytes=FORM_BYTES)
def start(page: ThePage, store: TheStore, wake: TheWake, form: TheForm) -> Response:
    """Take the answers: make a scan of the inspected file and calibrate with it."""
    if "scan_id" in form:
        return _start_of_scan(page, store, wake, form)
    where = PageAddress(form.get("scanner_id"), form.get("inspection_id"))
    inspection = store.inspections.get(where.inspection or "")
    if inspection.result is None:
        return _of_inspection(page, store, where, inspection)
    texts = {name: value for name, value in form.items() if name in _Answers.model_fields and value.strip()}
    try:
        answers = _Answers.model_validate(texts | {"name": inspection.options.name})
        store.phantoms.usable(answers.phantom_id)
        calibration = _started(store, wake, ScanSpec(**answers.model_dump(exclude_unset=True)), inspection.id)
    except ValidationError as error:
        return _asked_again(page, store, where, inspection, form, _sentence(page, error))
    except (NotFound, Conflict) as error:
        return _asked_again(page, store, where, inspection, form, str(error))
    except QueueFull as error:
        return _asked_again(page, store, where, inspection, form, str(error), status=STATUS[QueueFull])
    return RedirectResponse(where.path(calibration=calibration.id), 303)


def _start_of_scan(page: PageFrame, store: Store, wake: TheWake, form: dict[str, str]) -> Response:
    where = PageAddress(scan=form["scan_id"])
    try:
        ask = CalibrationAsk(scan_id=form["scan_id"], phantom_id=form.get("phantom_id") or None)
        calibration = store.calibrations.accept(ask)
    except ValidationError as error:
        return _of_scan(page, store, where, form["scan_id"], _sentence(page, error))
    except Conflict as error:
        return _of_scan(page, store, where, form["scan_id"], str(error))
    wake(calibration.job_id)
    return RedirectResponse(where.path(scan=None, calibration=calibration.id), 303)


@router.post(f"{CALIBRATE}/dataset", needs=Scope.SUBMIT)
def choose_dataset(page: ThePage, store: TheStore, wake: TheWake, form: TheForm) -> Response:
    """Inspect the file again, with another array."""
    where = PageAddress(form.get("scanner_id"), form.get("inspection_id"))
    earlier = store.inspections.get(where.inspection or "")
    if earlier.result is None:
        return _of_inspection(page, store, where, earlier)
    try:
        options = InspectionOptions(dataset=form.get("dataset") or None)
        received = store.inspections.received_again(earlier.id)
    except (ValidationError, StorageError) as error:
        sentence = _sentence(page, error) if isinstance(error, ValidationError) else str(error)
        return _asked_again(page, store, where, earlier, form, sentence)
    inspection = store.inspections.accept_file(options, received, name=earlier.options.name)
    wake(inspection.job_id)
    return RedirectResponse(where.path(inspection=inspection.id), 303)


def _started(store: Store, wake: TheWake, spec: ScanSpec, inspection_id: str) -> CalibrationUnfinished:
    received = store.inspections.received_again(inspection_id)
    with store.as_one():
        scan = store.scans.accept(spec, received)
        calibration = store.calibrations.accept(CalibrationAsk(scan_id=scan.id))
    for job_id in (scan.job_id, calibration.job_id):
        wake(job_id)
    assert isinstance(calibration, CalibrationUnfinished)  # noqa: S101 - it was only just requested
    return calibration


def _sentence(page: PageFrame, error: ValidationError) -> str:
    """Return the first complaint about an answer; for a missing answer, a request to give it."""
    field, message = complaint(error.errors()[0])
    if message == "is required":
        return page.text.gettext("Answer every question: %(field)s is missing.") % {"field": field}
    return f"{field} {message}"


def _asked_again(
    page: PageFrame,
    store: Store,
    where: PageAddress,
    inspection: Inspection,
    form: dict[str, str],
    problem: str,
    *,
    status: int = 422,
) -> HTMLResponse:
    """Show the questions again, with the answers as they were given."""
    questions = questions_of(store, inspection, form)
    return page.answer("calibrate_questions.html", status=status, where=where, questions=questions, problem=problem)


def _of_inspection(page: PageFrame, store: Store, where: PageAddress, inspection: Inspection) -> HTMLResponse:
    if inspection.state in {"queued", "running"}:
        return page.answer("calibrate_looking.html", where=where, inspection=inspection)
    result = inspection.result
    if result is None or result.refusal is not None:
        failure = inspection.failure if result is None else result.refusal
        return page.answer("calibrate_refused.html", where=where, inspection=inspection, failure=failure)
    questions = questions_of(
        store, inspection, {"scanner_id": where.scanner or "", **_earlier(store.scans, where.scan)}
    )
    return page.answer("calibrate_questions.html", where=where, questions=questions, problem=None)


def _of_scan(
    page: PageFrame, store: Store, where: PageAddress, scan_id: str, problem: str | None = None
) -> HTMLResponse:
    """Show a scan that was sent before; the only question is which phantom it shows."""
    scan = store.scans.get(scan_id)
    return page.answer(
        "calibrate_scan.html",
        status=422 if problem else 200,
        where=where,
        scan=scan,
        scanner=store.scanners.get(scan.scanner_id),
        phantoms=usable_phantoms(store.phantoms),
        chosen_phantom=scan.phantom_id,
        problem=problem,
    )


def _of_calibration(
    page: PageFrame, store: Store, where: PageAddress, calibration: CalibrationSucceeded | CalibrationUnfinished
) -> HTMLResponse:
    scanner, scan = store.scanners.get(calibration.scanner_id), scan_if_kept(store.scans, calibration.scan_id)
    if isinstance(calibration, CalibrationSucceeded):
        condition = condition_of(store, scanner)
        return page.answer(
            "calibrate_result.html",
            where=where,
            calibration=calibration,
            scanner=scanner,
            scan=scan,
            step=condition.step_with(calibration),
            newest=condition.newest,
            changes=changes_of(page, calibration.comparison),
            parameters=parameters_of(page, calibration),
            log=shown_log(store.files, calibration.id),
        )
    if calibration.state in {"queued", "running"}:
        jobs = [calibration.job_id] if scan is None else [scan.job_id, calibration.job_id]
        return page.answer(
            "calibrate_running.html",
            where=where,
            calibration=calibration,
            scanner=scanner,
            jobs=jobs,
            stages=stages(page),
        )
    unread = None if scan is None or scan.state is not ScanState.REFUSED else store.jobs.get(scan.job_id).failure
    failure = unread or calibration.failure
    return page.answer(
        "calibrate_failed.html",
        where=where,
        scanner=scanner,
        cancelled=calibration.state == "cancelled",
        unread=unread is not None,
        failure=failure,
        advice=advice_for(page, failure, unread=unread is not None),
        again=_again(store.files, where, scan),
    )


def _earlier(scans: TheScans, scan_id: str | None) -> dict[str, str]:
    """Return the answers that made a scan of the same file; none where the scan was deleted since."""
    scan = None if scan_id is None else scan_if_kept(scans, scan_id)
    values = {} if scan is None else {name: getattr(scan, name) for name in ASKED}
    return {name: str(value) for name, value in values.items() if value is not None}


def _again(files: TheFiles, where: PageAddress, scan: Scan | None) -> str | None:
    """Return the address that asks about the same file or its scan again; None where neither is possible."""
    if scan is None:
        return None
    if where.inspection is not None and files.upload(job_kinds.INSPECT, where.inspection).exists():
        return where.path(calibration=None, scan=scan.id)
    return None if scan.state is ScanState.REFUSED else PageAddress(scan=scan.id).path()
