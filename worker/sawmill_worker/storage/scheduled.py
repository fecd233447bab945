"""What a schedule asks for at a due time: which scan is new to it, and the job that is queued for it."""

from datetime import datetime
from typing import NamedTuple

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from sawmill_worker.contracts import calibrations, drifts
from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.contracts.choices import ScheduleOutcome
from sawmill_worker.contracts.drifts import DriftAsk
from sawmill_worker.contracts.jobs import Priority
from sawmill_worker.contracts.phantoms import PhantomState
from sawmill_worker.contracts.scans import ScanState
from sawmill_worker.storage.asked import queue_asked
from sawmill_worker.storage.files import FileStore
from sawmill_worker.storage.scanners import active_calibration_id
from sawmill_worker.storage.tables import CalibrationRow, DriftRow, PhantomRow, ScanRow, ScheduleRow

# A drift check pairs opposite rays all round in steps of 3 degrees or less: this number of views, from the first
# angle to the last. What else a scan may lack, the check finds.
LEAST_VIEWS, LEAST_RANGE_DEG = 120, 354.0


class Outcome(NamedTuple):
    """The outcome of a due time, and the id of what was queued."""

    outcome: ScheduleOutcome
    calibration_id: str | None = None
    drift_id: str | None = None


def queue_due(session: Session, files: FileStore, row: ScheduleRow, now: datetime) -> Outcome:
    """Queue what a schedule is for, where there is a scan for it."""
    do = _check_drift if row.kind == "check-drift" else _recalibrate
    return do(session, files, row, now)


def _recalibrate(session: Session, files: FileStore, row: ScheduleRow, now: datetime) -> Outcome:
    """With the scanner's newest usable phantom scan, unless a schedule has used it: an older one shows the past."""
    newest = session.scalar(
        select(ScanRow)
        .join(PhantomRow, PhantomRow.id == ScanRow.phantom_id)
        .where(ScanRow.scanner_id == row.scanner_id, ScanRow.state == ScanState.READY)
        .where(PhantomRow.state == PhantomState.READY)
        .order_by(ScanRow.created_at.desc(), ScanRow.id.desc())
        .limit(1)
    )
    if newest is None:
        return Outcome("no-new-phantom-scan")
    used = exists().where(CalibrationRow.scan_id == newest.id, CalibrationRow.schedule_id.is_not(None))
    if session.scalar(select(used)):
        return Outcome("no-new-phantom-scan")
    ask = CalibrationAsk.model_validate({**row.options, "scan_id": newest.id, "activate": row.on_pass == "activate"})  # noqa: S105 - no password
    given = {"schedule_id": row.id}
    queued = queue_asked(session, files, calibrations.DECLARATION, ask, now, given=given, priority=Priority.BATCH)
    return Outcome("queued", calibration_id=queued.id)


def _check_drift(session: Session, files: FileStore, row: ScheduleRow, now: datetime) -> Outcome:
    """On the newest log scan that is fit for it, of those after the last one that any drift check has looked at."""
    if active_calibration_id(session, row.scanner_id) is None:
        return Outcome("no-active-calibration")
    logs = select(ScanRow.id).where(ScanRow.scanner_id == row.scanner_id, ScanRow.phantom_id.is_(None))
    looked_at = (
        select(ScanRow.created_at)
        .join(DriftRow, DriftRow.scan_id == ScanRow.id)
        .where(ScanRow.scanner_id == row.scanner_id, ScanRow.phantom_id.is_(None))
        .order_by(ScanRow.created_at.desc())
        .limit(1)
    )
    if (last := session.scalar(looked_at)) is not None:
        logs = logs.where(ScanRow.created_at > last)
    angles_deg = ScanRow.reading["angular_range_deg"]
    newest = session.scalar(
        logs.where(ScanRow.state == ScanState.READY)
        .where(ScanRow.reading["shape"]["views"].as_integer() >= LEAST_VIEWS)
        .where(func.abs(angles_deg[1].as_float() - angles_deg[0].as_float()) >= LEAST_RANGE_DEG)
        .order_by(ScanRow.created_at.desc(), ScanRow.id.desc())
        .limit(1)
    )
    if newest is None:
        return Outcome("no-new-log-scan")
    ask = DriftAsk(scan_id=newest, **row.drift_options)
    queued = queue_asked(session, files, drifts.DECLARATION, ask, now, priority=Priority.BATCH)
    return Outcome("queued", drift_id=queued.id)
