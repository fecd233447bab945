"""What a job's end means for the scan, phantom, calibration, reconstruction, plan or look at drift it worked on."""

from collections.abc import Callable
from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session

from sawmill_worker.contracts.base import Contract
from sawmill_worker.contracts.calibrations import CalibrationResult
from sawmill_worker.contracts.drifts import DriftResult
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.phantoms import PhantomDrawing, PhantomState
from sawmill_worker.contracts.plans import PlanResult
from sawmill_worker.contracts.reconstructions import ReconstructionResult
from sawmill_worker.contracts.scans import ScanReading, ScanState
from sawmill_worker.storage.paging import found
from sawmill_worker.storage.scanners import activate
from sawmill_worker.storage.tables import (
    CalibrationRow,
    DriftRow,
    Json,
    PhantomRow,
    PlanRow,
    ReconstructionRow,
    ScanRow,
)

_RESULT: dict[JobKind, type[Contract]] = {
    JobKind.INGEST: ScanReading,
    JobKind.TRACE_PHANTOM: PhantomDrawing,
    JobKind.CALIBRATE: CalibrationResult,
    JobKind.RECONSTRUCT: ReconstructionResult,
    JobKind.PLAN: PlanResult,
    JobKind.DRIFT: DriftResult,
}


def checked_result(kind: JobKind, result: dict[str, Any]) -> Json:
    """A job's result in the form in which it is stored.

    Raises
    ------
    pydantic.ValidationError
        It is not what jobs of this kind answer with.
    """
    return _RESULT[kind].model_validate(result).model_dump(mode="json")


def record_success(session: Session, kind: JobKind, subject_id: str, result: Json, now: datetime) -> None:
    """Write a checked result to the job's subject."""
    _SUCCESS[kind](session, subject_id, result, now)


def record_end_without_result(session: Session, kind: JobKind, subject_id: str, reason: str) -> None:
    """Refuse the scan or phantom whose job failed or was cancelled; other subjects have their job's state."""
    if kind is JobKind.INGEST:
        scan = found(session, ScanRow, "scan", subject_id)
        scan.state, scan.reason = ScanState.REFUSED, reason
    elif kind is JobKind.TRACE_PHANTOM:
        phantom = found(session, PhantomRow, "phantom", subject_id)
        phantom.state, phantom.reason = PhantomState.REFUSED, reason


def _scan_read(session: Session, subject_id: str, result: Json, _: datetime) -> None:
    scan = found(session, ScanRow, "scan", subject_id)
    scan.state, scan.reading = ScanState.READY, result


def _phantom_traced(session: Session, subject_id: str, result: Json, _: datetime) -> None:
    phantom = found(session, PhantomRow, "phantom", subject_id)
    phantom.state, phantom.drawing = PhantomState.READY, result


def _calibrated(session: Session, subject_id: str, result: Json, now: datetime) -> None:
    calibration = found(session, CalibrationRow, "calibration", subject_id)
    calibration.result = result
    # A schedule never takes over a scanner that has moved: that is the technician's to see and to accept.
    moved = calibration.schedule_id is not None and (result["comparison"] or {}).get("within_tolerance") is False
    if calibration.activate and result["verdict"] == "pass" and not moved:
        asker = f"schedule {calibration.schedule_id}" if calibration.schedule_id else "the request"
        activate(
            session, calibration.scanner_id, calibration.id, f"verdict pass; {asker} asked for activation on pass", now
        )


def _reconstructed(session: Session, subject_id: str, result: Json, _: datetime) -> None:
    found(session, ReconstructionRow, "reconstruction", subject_id).result = result


def _planned(session: Session, subject_id: str, result: Json, _: datetime) -> None:
    found(session, PlanRow, "plan", subject_id).result = result


def _drift_seen(session: Session, subject_id: str, result: Json, _: datetime) -> None:
    found(session, DriftRow, "drift", subject_id).result = result


_SUCCESS: dict[JobKind, Callable[[Session, str, Json, datetime], None]] = {
    JobKind.INGEST: _scan_read,
    JobKind.TRACE_PHANTOM: _phantom_traced,
    JobKind.CALIBRATE: _calibrated,
    JobKind.RECONSTRUCT: _reconstructed,
    JobKind.PLAN: _planned,
    JobKind.DRIFT: _drift_seen,
}
