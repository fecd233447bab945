"""`/calibrations/{id}/report`: a page that prints on A4, the same that `sawmill report` writes.

The report can be saved and sent: it is the one page without the common frame. Drawing modules are imported by the
first report: a service at rest does not hold them.
"""
# ruff: noqa: PLC0415 - for that reason

from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Annotated
from zoneinfo import ZoneInfo

from fastapi import Query, Request, Response
from fastapi.responses import HTMLResponse

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationSucceeded
from sawmill_contracts.history import HistoryKind
from sawmill_formats.errors import damage_reported
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import if_found
from sawmill_service.dependencies import TheStore
from sawmill_service.drawing import DRAWING, FIGURE_BYTES
from sawmill_service.http.responses.drawn import Drawn
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import Language, known_zone, texts
from sawmill_service.pages.frame.page_frame import formats_of
from sawmill_service.pages.frame.stored_words import stored_words
from sawmill_service.routes.calibrations import succeeded
from sawmill_service.scanner_conditions import step_with
from sawmill_store.mill_files import MillFiles
from sawmill_store.store import Store

if TYPE_CHECKING:
    from sawmill_calibration.pictures.report_page import About
    from sawmill_vocabulary.calibration_arrays import CalibrationArrays

router = Router(include_in_schema=False, reading=Scope.READ)


@router.get("/calibrations/{calibration_id}/report")
def report(
    calibration_id: Identifier,
    request: Request,
    store: TheStore,
    language: Annotated[Language, Query()] = Language.ENGLISH,
) -> Response:
    """Show the report of a calibration that has an answer, in English or another language."""
    from sawmill_calibration.pictures.report_page import report_html

    calibration = succeeded(store.calibrations, calibration_id, "report")
    about, reader = _about(store, calibration, language), formats_of(language).reader

    def draw() -> Response:
        with DRAWING:
            html = report_html(calibration, about, stored_arrays(store.files, calibration_id), reader)
        return HTMLResponse(html, headers={"Cache-Control": "no-store", "Vary": "Cookie"})

    return Drawn(request, FIGURE_BYTES, draw)


def _about(store: Store, calibration: CalibrationSucceeded, language: str) -> "About":
    from sawmill_calibration.pictures.report_page import About

    scanner, scan = store.scanners.get(calibration.scanner_id), if_found(store.scans.get, calibration.scan_id)
    activation = store.history.newest(scanner.id, HistoryKind.ACTIVATION, calibration.id)
    zone, words = _zone(store, scanner.id), partial(stored_words, translate=texts(language).gettext)

    schedule_id = calibration.schedule_id
    asked_by = f"schedule {schedule_id}" if schedule_id else store.jobs.get(calibration.job_id).asked_by

    def written(time: datetime) -> str:
        local = time.astimezone(None if zone is None else ZoneInfo(zone))
        return f"{formats_of(language).moment(time, zone)} ({zone or local.tzname()})"

    return About(
        calibration_id=calibration.id,
        made_at=calibration.created_at.astimezone(None if zone is None else ZoneInfo(zone)),
        made=written(calibration.created_at),
        scanner_name=scanner.name,
        scanner_id=scanner.id,
        scan_name=None if scan is None else scan.name,
        scan_id=calibration.scan_id,
        phantom=store.phantoms.get(calibration.phantom_id).drawing,
        phantom_name=words(calibration.phantom),
        tolerances=scanner.tolerances,
        asked_by=words(asked_by or ""),
        active=scanner.active_calibration_id == calibration.id,
        activated="" if activation is None else written(activation.at),
        activated_why="" if activation is None else words(activation.why or ""),
        step=step_with(store, calibration),
        back=f"/scanners/{scanner.id}",
    )


def _zone(store: Store, scanner_id: str) -> str | None:
    """Return the mill's time zone, or until it is set the newest schedule's; None: this machine's."""
    newest = store.schedules.page(scanner_id=scanner_id, limit=1).items
    named = store.mill_zone.get() or (newest[0].time_zone if newest else None)
    return None if named is None else known_zone(named)


def stored_arrays(files: MillFiles, calibration_id: str) -> "CalibrationArrays | None":
    """Read the arrays of result.h5; None where the file was removed."""
    from sawmill_formats.output import calibration_file
    from sawmill_vocabulary.calibration_arrays import CalibrationArrays

    path = if_found(files.result, kinds.CALIBRATE, calibration_id, "result.h5")
    if path is None:
        return None
    arrays = calibration_file.read_calibration(path).arrays
    with damage_reported(path.name):
        return CalibrationArrays.of(arrays)
