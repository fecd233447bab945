"""Effects of a job's end on the thing that the job worked on."""

from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session

from sawmill_contracts.events import EventKind
from sawmill_contracts.jobs import JobKind
from sawmill_contracts.kinds import AskedKind, declaration_of
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_mill.activation import activation_reason
from sawmill_store.acting import THE_SERVICE, Actor, acting_as
from sawmill_store.activations import activate
from sawmill_store.asked_rows import found_asked
from sawmill_store.events import announce
from sawmill_store.measurements import record_measurement
from sawmill_store.paging import found
from sawmill_store.tables import CalibrationRow, Json, PhantomRow, ScanRow


def checked_result(kind: JobKind, result: dict[str, Any]) -> Json:
    """Check a job's result and return it in the form in which it is stored.

    Raises
    ------
    pydantic.ValidationError
        It is not what jobs of this kind answer with.
    """
    return declaration_of(kind).result.model_validate(result).model_dump(mode="json")


def record_success(session: Session, kind: JobKind, subject_id: str, result: Json, now: datetime) -> None:
    """Write a checked result to the job's subject."""
    declared = declaration_of(kind)
    if isinstance(declared, AskedKind):
        row = found_asked(session, declared, subject_id)
        row.result = result
        record_measurement(session, row, now)
        if isinstance(row, CalibrationRow):
            _activate_on_pass(session, row, result, now)
    elif kind is JobKind.INGEST:
        scan = found(session, ScanRow, "scan", subject_id)
        scan.state, scan.reading = ScanState.READY, result
        announce(session, now, EventKind.SCAN_READY, "scan", scan.id, scanner_id=scan.scanner_id)
    else:
        phantom = found(session, PhantomRow, "phantom", subject_id)
        phantom.state, phantom.drawing = PhantomState.READY, result
        announce(session, now, EventKind.PHANTOM_READY, "phantom", phantom.id)


def record_end_without_result(session: Session, kind: JobKind, subject_id: str, reason: str, now: datetime) -> None:
    """Refuse the scan or phantom whose job failed or was cancelled; other subjects have their job's state."""
    if kind is JobKind.INGEST:
        scan = found(session, ScanRow, "scan", subject_id)
        scan.state, scan.reason = ScanState.REFUSED, reason
        why = {"reason": reason}
        announce(session, now, EventKind.SCAN_REFUSED, "scan", scan.id, scanner_id=scan.scanner_id, detail=why)
    elif kind is JobKind.TRACE_PHANTOM:
        phantom = found(session, PhantomRow, "phantom", subject_id)
        phantom.state, phantom.reason = PhantomState.REFUSED, reason
        announce(session, now, EventKind.PHANTOM_REFUSED, "phantom", phantom.id, detail={"reason": reason})


def _activate_on_pass(session: Session, calibration: CalibrationRow, result: Json, now: datetime) -> None:
    reason = activation_reason(
        wanted=calibration.activate,
        schedule_id=calibration.schedule_id,
        rays_verdict=result["rays_verdict"] or result["verdict"],  # an earlier version has the verdict alone
        has_moved=(result["comparison"] or {}).get("within_tolerance") is False,
    )
    if reason is not None:
        job = calibration.job
        by_request = Actor(job.asked_by or THE_SERVICE.name, job.key_id, request_id=job.request_id)
        with acting_as(by_request):
            activate(session, calibration.scanner_id, calibration.id, reason, now)
