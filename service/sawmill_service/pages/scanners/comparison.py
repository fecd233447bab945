"""`/scanners/{scanner_id}/compare`: the differences of any two calibrations of a scanner, and one log with both."""

import math
from typing import Annotated

from fastapi import Query, Response
from fastapi.responses import RedirectResponse

from sawmill_contracts.calibrations import CalibrationSucceeded
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scans import ScanState
from sawmill_mill.calibration_differences import differences
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict, Invalid, NotFound, QueueFull
from sawmill_service.dependencies import TheStore, TheWake
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import STATUS
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.calibrate.calibrate_words import PARAMETERS
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.scanners.scanner_history import VERDICTS
from sawmill_service.routes.calibrations import succeeded
from sawmill_store.store import Store

# Number of the newest calibrations and scans from which people choose.
_MOST = 100
_KEPT = (JobState.QUEUED, JobState.RUNNING, JobState.SUCCEEDED)

router = Router(include_in_schema=False, reading=Scope.READ)
Chosen = Annotated[str, Query(max_length=64)]


@router.get("/scanners/{scanner_id}/compare")
def compare(
    scanner_id: Identifier, page: ThePage, store: TheStore, first: Chosen = "", second: Chosen = ""
) -> Response:
    """Show two calibrations, the newest two unless others are chosen."""
    return _page(page, store, scanner_id, (first, second))


@router.post("/scanners/{scanner_id}/compare", needs=Scope.SUBMIT)
def reconstruct_with_both(
    scanner_id: Identifier, page: ThePage, store: TheStore, wake: TheWake, fields: TheForm
) -> Response:
    """Request the same log with both calibrations, unless it is there, and go to the second with the first beside."""
    chosen, scan_id = (fields.get("first", ""), fields.get("second", "")), store.scans.get(fields.get("scan_id", "")).id
    for calibration_id in chosen:
        _calibration(store, scanner_id, calibration_id)
    logs = [log for log in store.reconstructions.page(scan_id=scan_id, limit=_MOST).items if log.state in _KEPT]
    made = []
    try:
        for calibration_id in chosen:
            ask = ReconstructionRequest(scan_id=scan_id, calibration_id=calibration_id)
            log = next((log for log in logs if log.options.model_dump() == ask.model_dump()), None)
            if log is None:
                log = store.reconstructions.accept(ask)
                wake(log.job_id)
            made.append(log.id)
    except (Conflict, Invalid, QueueFull) as error:
        return _page(page, store, scanner_id, chosen, status=STATUS[type(error)], problem=str(error))
    return RedirectResponse(f"/logs/{made[1]}?beside={made[0]}", status_code=303)


def _page(
    page: PageFrame, store: Store, scanner_id: str, chosen: tuple[str, str], *, status: int = 200, problem: str = ""
) -> Response:
    scanner = store.scanners.get(scanner_id)
    listed = store.calibrations.page(scanner_id=scanner_id, state=JobState.SUCCEEDED, limit=_MOST).items
    newest = [each.id for each in listed[1::-1]]
    both = [_calibration(store, scanner_id, each) for each in (chosen if all(chosen) else newest)]
    discards = store.history.page(scanner_id, kind=HistoryKind.DISCARD, limit=_MOST).items
    scans = store.scans.page(scanner_id=scanner_id, limit=_MOST).items
    return page.answer(
        "comparison.html",
        status=status,
        problem=problem,
        scanner=scanner,
        listed={each.id: each for each in (*listed, *both)},
        both=both,
        names=store.scans.several({each.scan_id for each in (*listed, *both)}),
        discarded={entry.subject_id for entry in discards},
        verdicts=VERDICTS,
        differences=list(differences(*both)) if len(both) > 1 else [],
        parameters=PARAMETERS,
        degrees_a_radian=math.degrees(1.0),
        scans=sorted(
            (scan for scan in scans if scan.state is ScanState.READY), key=lambda scan: scan.phantom_id is not None
        ),
    )


def _calibration(store: Store, scanner_id: str, calibration_id: str) -> CalibrationSucceeded:
    calibration = succeeded(store.calibrations, calibration_id, "comparison")
    if calibration.scanner_id != scanner_id:
        raise NotFound("calibration", calibration_id)
    return calibration
