"""Jobs of schedules: candidates for the rules of `sawmill_mill.schedules`, and the job that is queued."""

from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Select, exists, select
from sqlalchemy.orm import Session

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.choices import ScheduleOutcome
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_mill.schedules import FEWEST_VIEWS, UNSEEN, LogScan, PhantomScan, log_scan_to_check, phantom_scan_to_use
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.database.paging import found
from sawmill_platform.database.tables import JobRow
from sawmill_store.activations import ScannerId, active_calibration_id
from sawmill_store.mill_tables import CalibrationRow, DriftRow, PhantomRow, ScanRow, ScheduleRow
from sawmill_store.requests.asked import Asked

# The statements select by the same rules: the newest scan is chosen, unless a rule is stricter than its statement.
_CANDIDATES = 20


class Outcome(NamedTuple):
    """The outcome of a due time, and the id of the queued calibration or drift check."""

    outcome: ScheduleOutcome
    calibration_id: str | None = None
    drift_id: str | None = None


def queue_due(
    session: Session,
    calibrations: Asked[CalibrationRequest, Any],
    drifts: Asked[DriftRequest, Any],
    row: ScheduleRow,
    now: datetime,
) -> Outcome:
    """Queue the calibration or the drift check of a schedule, if there is a scan for it."""
    if row.kind == "check-drift":
        return _check_drift(session, drifts, row, now)
    return _recalibrate(session, calibrations, row, now)


def newest_phantom_scan(scanner_id: ScannerId) -> Select[str]:
    """Select the newest usable phantom scan of a scanner."""
    return (
        select(ScanRow.id)
        .join(PhantomRow, PhantomRow.id == ScanRow.phantom_id)
        .where(ScanRow.scanner_id == scanner_id, ScanRow.state == ScanState.READY)
        .where(PhantomRow.state == PhantomState.READY)
        .order_by(ScanRow.created_at.desc(), ScanRow.id.desc())
        .limit(1)
    )


def last_looked_at(scanner_id: ScannerId) -> Select[datetime]:
    """Select the time of the newest stored log scan of a scanner that a drift check has used."""
    return (
        select(ScanRow.created_at)
        .join(DriftRow, DriftRow.scan_id == ScanRow.id)
        .join(JobRow, JobRow.id == DriftRow.job_id)
        .where(ScanRow.scanner_id == scanner_id, ScanRow.phantom_id.is_(None), JobRow.state.not_in(UNSEEN))
        .order_by(ScanRow.created_at.desc())
        .limit(1)
    )


def next_log(session: Session, scanner_id: str) -> str | None:
    """Choose the log scan that a schedule checks for drift next."""
    views, is_checked = ScanRow.reading["shape"]["views"].as_integer(), exists().where(DriftRow.scan_id == ScanRow.id)
    logs = select(ScanRow.id, ScanRow.created_at, ScanRow.state, views, is_checked)
    logs = logs.where(ScanRow.scanner_id == scanner_id, ScanRow.phantom_id.is_(None))
    if (last := session.scalar(last_looked_at(scanner_id))) is not None:
        logs = logs.where(ScanRow.created_at > last)
    narrowed = logs.where(ScanRow.state == ScanState.READY, ~is_checked, views >= FEWEST_VIEWS)
    newest_first = narrowed.order_by(ScanRow.created_at.desc(), ScanRow.id.desc()).limit(_CANDIDATES)
    return log_scan_to_check((LogScan(*row) for row in session.execute(newest_first)), last)


def _recalibrate(
    session: Session, calibrations: Asked[CalibrationRequest, Any], row: ScheduleRow, now: datetime
) -> Outcome:
    """Queue a calibration of the phantom scan that the rule chooses."""
    is_used = exists().where(CalibrationRow.scan_id == ScanRow.id, CalibrationRow.schedule_id.is_not(None))
    columns = ScanRow.id, ScanRow.state, PhantomRow.state, is_used
    newest_first = newest_phantom_scan(row.scanner_id).with_only_columns(*columns).limit(_CANDIDATES)
    scan_id = phantom_scan_to_use(PhantomScan(*each) for each in session.execute(newest_first))
    if scan_id is None:
        return Outcome("no-new-phantom-scan")
    ask = CalibrationRequest.model_validate({**row.options, "scan_id": scan_id, "activate": row.on_pass == "activate"})  # noqa: S105 - no password
    queued = calibrations.queue(session, ask, now, given={"schedule_id": row.id}, priority=Priority.BATCH)
    return Outcome("queued", calibration_id=queued.id)


def _check_drift(session: Session, drifts: Asked[DriftRequest, Any], row: ScheduleRow, now: datetime) -> Outcome:
    """Queue a drift check of the log scan that the rule chooses."""
    if active_calibration_id(session, row.scanner_id) is None:
        return Outcome("no-active-calibration")
    scan_id = next_log(session, row.scanner_id)
    if scan_id is None:
        return Outcome("no-new-log-scan")
    # A scan that was uploaded as a mean has no rows to choose from.
    is_mean = found(session, ScanRow, "scan", scan_id).spec.get("averaged_rows") is not None
    ask = DriftRequest(scan_id=scan_id, **row.drift_options | ({"rows": None} if is_mean else {}))
    return Outcome("queued", drift_id=drifts.queue(session, ask, now, priority=Priority.BATCH).id)
