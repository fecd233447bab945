"""What a schedule asks for at a due time: which scan is new to it, and the job that is queued for it."""

from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Select, exists, select
from sqlalchemy.orm import Session

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.choices import ScheduleOutcome
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import JobState, Priority
from sawmill_platform.database.tables import JobRow
from sawmill_store.activations import ScannerId, active_calibration_id
from sawmill_store.asked import Asked
from sawmill_store.tables import CalibrationRow, DriftRow, PhantomRow, ScanRow, ScheduleRow
from sawmill_vocabulary import FEWEST_PAIRED_VIEWS

# A drift check whose job ended so has not looked at its scan.
_UNSEEN = (JobState.FAILED, JobState.CANCELLED)


class Outcome(NamedTuple):
    """The outcome of a due time, and the id of what was queued."""

    outcome: ScheduleOutcome
    calibration_id: str | None = None
    drift_id: str | None = None


def queue_due(
    session: Session,
    calibrations: Asked[CalibrationAsk, Any],
    drifts: Asked[DriftAsk, Any],
    row: ScheduleRow,
    now: datetime,
) -> Outcome:
    """Queue what a schedule is for, where there is a scan for it."""
    if row.kind == "check-drift":
        return _check_drift(session, drifts, row, now)
    return _recalibrate(session, calibrations, row, now)


def newest_phantom_scan(scanner_id: ScannerId) -> Select[str]:
    """The newest usable phantom scan of a scanner, which a schedule calibrates unless one has used it."""
    return (
        select(ScanRow.id)
        .join(PhantomRow, PhantomRow.id == ScanRow.phantom_id)
        .where(ScanRow.scanner_id == scanner_id, ScanRow.state == ScanState.READY)
        .where(PhantomRow.state == PhantomState.READY)
        .order_by(ScanRow.created_at.desc(), ScanRow.id.desc())
        .limit(1)
    )


def last_looked_at(scanner_id: ScannerId) -> Select[datetime]:
    """When the newest log scan of a scanner came that a drift check has looked at, of those that are stored."""
    return (
        select(ScanRow.created_at)
        .join(DriftRow, DriftRow.scan_id == ScanRow.id)
        .join(JobRow, JobRow.id == DriftRow.job_id)
        .where(ScanRow.scanner_id == scanner_id, ScanRow.phantom_id.is_(None), JobRow.state.not_in(_UNSEEN))
        .order_by(ScanRow.created_at.desc())
        .limit(1)
    )


def next_log(session: Session, scanner_id: str) -> str | None:
    """The newest log scan of a scanner that is fit for a drift check, of those after the last one that any looked at.

    Fit for it: of as many views as can be compared. What else a scan may lack, the check finds, and the next one passes
    that scan over.
    """
    logs = select(ScanRow.id).where(ScanRow.scanner_id == scanner_id, ScanRow.phantom_id.is_(None))
    if (last := session.scalar(last_looked_at(scanner_id))) is not None:
        logs = logs.where(ScanRow.created_at > last)
    return session.scalar(
        logs.where(ScanRow.state == ScanState.READY)
        .where(~exists().where(DriftRow.scan_id == ScanRow.id))
        .where(ScanRow.reading["shape"]["views"].as_integer() >= FEWEST_PAIRED_VIEWS)
        .order_by(ScanRow.created_at.desc(), ScanRow.id.desc())
        .limit(1)
    )


def _recalibrate(
    session: Session, calibrations: Asked[CalibrationAsk, Any], row: ScheduleRow, now: datetime
) -> Outcome:
    """With the scanner's newest usable phantom scan, unless a schedule has used it: an older one shows the past."""
    newest = session.scalar(newest_phantom_scan(row.scanner_id))
    if newest is None:
        return Outcome("no-new-phantom-scan")
    used = exists().where(CalibrationRow.scan_id == newest, CalibrationRow.schedule_id.is_not(None))
    if session.scalar(select(used)):
        return Outcome("no-new-phantom-scan")
    ask = CalibrationAsk.model_validate({**row.options, "scan_id": newest, "activate": row.on_pass == "activate"})  # noqa: S105 - no password
    queued = calibrations.queue(session, ask, now, given={"schedule_id": row.id}, priority=Priority.BATCH)
    return Outcome("queued", calibration_id=queued.id)


def _check_drift(session: Session, drifts: Asked[DriftAsk, Any], row: ScheduleRow, now: datetime) -> Outcome:
    """On the newest log scan that is new to all drift checks and fit for one."""
    if active_calibration_id(session, row.scanner_id) is None:
        return Outcome("no-active-calibration")
    newest = next_log(session, row.scanner_id)
    if newest is None:
        return Outcome("no-new-log-scan")
    # What came as a mean has no rows to choose from.
    is_mean = session.get_one(ScanRow, newest).spec.get("averaged_rows") is not None
    ask = DriftAsk(scan_id=newest, **row.drift_options | ({"rows": None} if is_mean else {}))
    queued = drifts.queue(session, ask, now, priority=Priority.BATCH)
    return Outcome("queued", drift_id=queued.id)
