"""`/calibrate`: from a file to the accepted calibration; the address alone determines the step.

Without parameters the page takes a file and, of a known scanner, waits for a scan from its watched folder; with
`inspection` it asks for what that file does not say; with `calibration` it follows the search and then shows the
result; with `scan` it asks about a scan that was sent before. In addition to other parameters, `inspection` is where
"other answers" leads back to, and `scan` has the answers that were given before. The address is kept while a new
scanner or phantom is made for the file.
"""

import re
from datetime import timedelta

from fastapi import Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from pydantic import ValidationError

from sawmill_contracts import kinds, mill_events
from sawmill_contracts.calibrations import CalibrationRequest, CalibrationSucceeded, CalibrationUnfinished
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.inspections import PICTURE_PX, Inspection, InspectionOptions, ScanPicture
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS
from sawmill_contracts.scans import Scan, ScanShape, ScanSpec, ScanState
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict, NotFound, QueueFull, StorageError, if_found
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.drawing import shown_log
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import STATUS, complaint
from sawmill_service.http.responses.drawn import picture
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.calibrate.calibrate_questions import LAST_SCANS, questions_of, usable_phantoms
from sawmill_service.pages.calibrate.calibrate_words import (
    CALIBRATE,
    TheWizardAddress,
    WizardAddress,
    changes_of,
    parameters_of,
)
from sawmill_service.pages.calibrate.report import stored_arrays
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.job_words import stages
from sawmill_service.scanner_conditions import condition_of
from sawmill_store.mill_files import MillFiles
from sawmill_store.store import Store
from sawmill_vocabulary import ReconstructionMethod
from sawmill_vocabulary.reading_messages import PreparingMessage

# Fields of a scan for which the form asks, and the parameters of the address that have the answers.
ASKED = {"scanner_id": "scanner", "phantom_id": "phantom", "data": "data", "angles_deg": "angles"}
# Age up to which a scan of a phantom is offered before a file is sent: a shift.
OFFERED_FOR = timedelta(hours=12)

# Number of views from which their number is no cause of a failure (docs/do/commissioning.md).
ENOUGH_VIEWS = 120
# Phantoms were seen with up to 0.19 % of the samples without signal, and not with 1.6 % or more: built-in phantoms
# simulated with 100 to 30 000 photons.
MOST_DARK_PERCENT = 0.5
# The form with an angle for each view: as many characters as a scan may have there, its commas as %2C.
FORM_BYTES = 400_000

router = Router(include_in_schema=False, reading=Scope.READ)


class _Answers(Given, ScanSpec):
    """Answers of the form about the scan: texts, as in a query."""

    phantom_id: Identifier


@router.get(CALIBRATE)
def calibrate(page: ThePage, store: TheStore, settings: TheSettings, where: TheWizardAddress) -> HTMLResponse:
    """Show the step between the file and the accepted calibration that the address names."""
    if where.calibration is not None:
        return _of_calibration(page, store, where, store.calibrations.get(where.calibration))
    if where.inspection is not None:
        return _of_inspection(page, store, where, store.inspections.get(where.inspection))
    if where.scan is not None:
        return _of_scan(page, store, where, where.scan)
    return _before_the_file(page, store, where, settings.max_upload_bytes)


@router.get(CALIBRATE + "/{inspection_id}/{name}")
def scan_picture(inspection_id: Identifier, name: ScanPicture, request: Request, store: TheStore) -> Response:
    """Return the picture of the scan in a file that was inspected."""
    from sawmill_calibration.pictures.images import grey_png  # noqa: PLC0415 - no other step needs it

    grey = store.files.result(kinds.INSPECT, inspection_id, name).read_bytes()
    return picture(request, grey, lambda: grey_png(grey, PICTURE_PX))


@router.post(CALIBRATE, needs=Scope.SUBMIT, max_form_bytes=FORM_BYTES)
def start(page: ThePage, store: TheStore, wake: TheWake, form: TheForm) -> Response:
    """Take the answers: make a scan of the inspected file and calibrate with it."""
    if "scan_id" in form:
        return _start_of_scan(page, store, wake, form)
    where = WizardAddress(form.get("scanner_id"), form.get("inspection_id"))
    inspection = store.inspections.get(where.inspection or "")
    if inspection.result is None:
        return _of_inspection(page, store, where, inspection)
    texts = {name: value for name, value in form.items() if name in _Answers.model_fields and value.strip()}
    try:
        answers = _Answers.model_validate(texts | {"name": inspection.options.name})
        store.phantoms.usable(answers.phantom_id)
        calibration = _started(store, wake, ScanSpec(**answers.model_dump(exclude_unset=True)), inspection.id)
    except ValidationError as error:
        return _asked(page, store, where, inspection, form, *_sentences(page, error))
    except (NotFound, Conflict) as error:
        return _asked(page, store, where, inspection, form, str(error))
    except QueueFull as error:
        return _asked(page, store, where, inspection, form, str(error), status=STATUS[QueueFull])
    return RedirectResponse(where.path(calibration=calibration.id), 303)


def _start_of_scan(page: PageFrame, store: Store, wake: TheWake, form: dict[str, str]) -> Response:
    where = WizardAddress(scan=form["scan_id"])
    try:
        ask = CalibrationRequest(scan_id=form["scan_id"], phantom_id=form.get("phantom_id") or None)
        calibration = store.calibrations.accept(ask)
    except ValidationError as error:
        return _of_scan(page, store, where, form["scan_id"], *_sentences(page, error))
    except Conflict as error:
        return _of_scan(page, store, where, form["scan_id"], str(error))
    wake(calibration.job_id)
    return RedirectResponse(where.path(scan=None, calibration=calibration.id), 303)


@router.post(f"{CALIBRATE}/dataset", needs=Scope.SUBMIT)
def choose_dataset(page: ThePage, store: TheStore, wake: TheWake, form: TheForm) -> Response:
    """Inspect the file again, with another array."""
    where = WizardAddress(form.get("scanner_id"), form.get("inspection_id"))
    earlier = store.inspections.get(where.inspection or "")
    if earlier.result is None:
        return _of_inspection(page, store, where, earlier)
    try:
        options = InspectionOptions(dataset=form.get("dataset") or None)
        received = store.inspections.received_again(earlier.id)
    except (ValidationError, StorageError) as error:
        problems = _sentences(page, error) if isinstance(error, ValidationError) else [str(error)]
        return _asked(page, store, where, earlier, form, *problems)
    inspection = store.inspections.accept_file(options, received, name=earlier.options.name)
    wake(inspection.job_id)
    return RedirectResponse(where.path(inspection=inspection.id), 303)


def _started(store: Store, wake: TheWake, spec: ScanSpec, inspection_id: str) -> CalibrationUnfinished:
    received = store.inspections.received_again(inspection_id)
    with store.database.write_as_one():
        scan = store.scans.accept(spec, received)
        calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
    for job_id in (scan.job_id, calibration.job_id):
        wake(job_id)
    assert isinstance(calibration, CalibrationUnfinished)  # noqa: S101 - it was only just requested
    return calibration


def _sentences(page: PageFrame, error: ValidationError) -> list[str]:
    """Return all complaints about the answers; for a missing answer, a request to give it."""
    missing = page.text.gettext("Answer every question: %(field)s is missing.")
    return [
        missing % {"field": field} if message == "is required" else f"{field} {message}"
        for field, message in map(complaint, error.errors())
    ]


def _asked(
    page: PageFrame,
    store: Store,
    where: WizardAddress,
    inspection: Inspection,
    answers: dict[str, str],
    *problems: str,
    status: int = 422,
) -> HTMLResponse:
    """Show the questions with the answers as they were given, and what is wrong with these."""
    folder = store.files.results(kinds.INSPECT, inspection.id)
    return page.answer(
        "calibrate_questions.html",
        status=status,
        where=where,
        questions=questions_of(store, inspection, answers),
        shown=next((name for name in ScanPicture if (folder / name).is_file()), None),
        problems=problems,
    )


def _before_the_file(page: PageFrame, store: Store, where: WizardAddress, max_bytes: int) -> HTMLResponse:
    """Show how a phantom is scanned, take a file, and lead to the scan of a phantom that the scanner sent itself."""
    number = store.events.reader().number
    scanners = store.scanners.page(limit=2).items
    only = scanners[0] if len(scanners) == 1 else None
    scanner = only if where.scanner is None else store.scanners.get(where.scanner)
    return page.answer(
        "calibrate_file.html",
        where=where,
        scanner=scanner,
        no_scanner=not scanners,
        newest=None if scanner is None else _newest_of_phantom(store, scanner.id),
        number=number,
        ended=(mill_events.SCAN_READY, mill_events.SCAN_REFUSED),
        max_bytes=max_bytes,
    )


def _newest_of_phantom(store: Store, scanner_id: str) -> Scan | None:
    """Return the scan of a phantom that the scanner sent last, if it is of this shift and nobody calibrated with it."""
    scans = store.scans.page(scanner_id=scanner_id, created_from=store.now() - OFFERED_FOR, limit=LAST_SCANS).items
    scan = next((scan for scan in scans if scan.phantom_id and scan.state is not ScanState.REFUSED), None)
    return None if scan is None or store.calibrations.page(scan_id=scan.id, limit=1).items else scan


def _of_inspection(page: PageFrame, store: Store, where: WizardAddress, inspection: Inspection) -> HTMLResponse:
    if inspection.state in {"queued", "running"}:
        return page.answer("calibrate_looking.html", inspection=inspection)
    result = inspection.result
    if result is None or result.refusal is not None:
        failure = inspection.failure if result is None else result.refusal
        # The stored calibration that the file was downloaded from; an HDF5 file has its id in its name.
        named = re.match(r"calibration-([a-z0-9][a-z0-9-]{0,63})", inspection.options.name)
        identifier = (inspection.result and inspection.result.calibration_id) or (named and named[1])
        held = identifier if identifier and store.calibrations.several([identifier]) else None
        return page.answer("calibrate_refused.html", where=where, inspection=inspection, failure=failure, held=held)
    addressed = {name: answer for name, parameter in ASKED.items() if (answer := getattr(where, parameter))}
    # A scan of the same file may have been made with other answers, and deleted since.
    scan = None if where.scan is None else if_found(store.scans.get, where.scan)
    earlier = {name: str(answer) for name in ASKED if (answer := getattr(scan, name, None)) is not None}
    return _asked(page, store, where, inspection, earlier | addressed, status=200)


def _of_scan(page: PageFrame, store: Store, where: WizardAddress, scan_id: str, *problems: str) -> HTMLResponse:
    """Show a scan that was sent before; the only question is which phantom it shows."""
    scan = store.scans.get(scan_id)
    return page.answer(
        "calibrate_scan.html",
        status=422 if problems else 200,
        where=where,
        scan=scan,
        scanner=store.scanners.get(scan.scanner_id),
        phantoms=usable_phantoms(store.phantoms),
        chosen_phantom=where.phantom or scan.phantom_id,
        problems=problems,
    )


def _of_calibration(
    page: PageFrame, store: Store, where: WizardAddress, calibration: CalibrationSucceeded | CalibrationUnfinished
) -> HTMLResponse:
    number = store.events.reader().number
    scanner, scan = store.scanners.get(calibration.scanner_id), if_found(store.scans.get, calibration.scan_id)
    discarded = store.history.newest(scanner.id, HistoryKind.DISCARD, calibration.id)
    if isinstance(calibration, CalibrationSucceeded):
        arrays = stored_arrays(store.files, calibration.id)
        condition = condition_of(store, scanner)
        return page.answer(
            "calibrate_result.html",
            where=where,
            calibration=calibration,
            number=number,
            activation=store.history.newest(scanner.id, HistoryKind.ACTIVATION, calibration.id),
            discarded=discarded,
            scanner=scanner,
            scan=scan,
            step=condition.step_with(calibration, discarded=discarded is not None),
            newest=condition.newest,
            changes=changes_of(page, calibration.comparison),
            parameters=parameters_of(page, calibration),
            outlined=arrays is not None and bool(arrays.phantom_image.any()),
            guessed=arrays is not None and arrays.phantom_image_method is ReconstructionMethod.TOTAL_VARIATION,
            log=shown_log(store.files, calibration.id),
        )
    if calibration.state in {"queued", "running"}:
        jobs = [calibration.job_id] if scan is None else [scan.job_id, calibration.job_id]
        return page.answer(
            "calibrate_running.html", calibration=calibration, scanner=scanner, jobs=jobs, stages=stages(page)
        )
    unread = None if scan is None or scan.state is not ScanState.REFUSED else store.jobs.get(scan.job_id).failure
    failure = unread or calibration.failure
    shape = scan.shape if scan is not None and failure is not None and failure.code == "phantom-not-seen" else None
    # The failure's sentence names the built-in phantom that explains the scan.
    named = re.search(r"the built-in drawing '([a-z0-9-]+)' explains the scan", failure.detail if failure else "")
    return page.answer(
        "calibrate_failed.html",
        where=where,
        scanner=scanner,
        cancelled=calibration.state == "cancelled",
        discarded=discarded,
        unread=unread is not None,
        failure=failure,
        scan=scan,
        likelier=store.phantoms.get(named[1]) if named and named[1] in BUILT_IN_PHANTOMS else None,
        views=shape.views if shape else ENOUGH_VIEWS,
        enough_views=ENOUGH_VIEWS,
        dark_percent=_dark_percent(scan, shape) if scan and shape else 0.0,
        most_dark_percent=MOST_DARK_PERCENT,
        again=_again(store.files, where, scan),
    )


def _dark_percent(scan: Scan, shape: ScanShape) -> float:
    """Return the percentage of a scan's samples without signal."""
    dark = sum(float(each.values["samples"]) for each in scan.coded_remarks if each.code == PreparingMessage.NO_SIGNAL)
    return 100.0 * dark / (shape.views * shape.rows * shape.detector)


def _again(files: MillFiles, where: WizardAddress, scan: Scan | None) -> str | None:
    """Return the address that asks about the same file or its scan again; None where neither is possible."""
    if scan is None:
        return None
    if where.inspection is not None and files.upload(kinds.INSPECT, where.inspection).exists():
        return where.path(calibration=None, scan=scan.id, scanner=None)
    return None if scan.state is ScanState.REFUSED else WizardAddress(scan=scan.id).path()
