"""Stocks that have rules of retention, and the conditions for which their rows stay, evaluated before a removal."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from sqlalchemy import Select, and_, exists, or_, select, union_all, update
from sqlalchemy.orm import Session

from sawmill_contracts import job_kinds
from sawmill_contracts.kinds import asked_kinds
from sawmill_contracts.retention import RetentionKind, StaysBecause
from sawmill_contracts.scans import ScanState
from sawmill_mill.retention import STAYS
from sawmill_platform.contracts.jobs import UNFINISHED, JobKind
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_platform.retention.stocks import KeptBy, Protection, Stock
from sawmill_store.activations import active_calibration
from sawmill_store.alarms import newest_accepted
from sawmill_store.scheduled import last_looked_at, newest_phantom_scan, next_log
from sawmill_store.tables import (
    ActivationRow,
    Answered,
    AskedRow,
    CalibrationRow,
    DriftRow,
    ReconstructionRow,
    ScannerRow,
    ScanRow,
    ScheduleRow,
    ScheduleRunRow,
    table_of,
)

Found = TypeVar("Found", str, int)

_UNFINISHED = JobRow.state.in_(UNFINISHED)


def calibrations_in_use(session: Session) -> set[str]:
    """Read each scanner's active calibration and the calibration that was active before."""
    active = active_calibration(ScannerRow.id).correlate(ScannerRow)
    before = active.where(ActivationRow.calibration_id != active.scalar_subquery())
    rows = session.execute(select(active.scalar_subquery(), before.scalar_subquery()).select_from(ScannerRow))
    return {identifier for row in rows for identifier in row if identifier is not None}


def _of_scans(session: Session) -> Iterator[Protection]:
    yield Protection(StaysBecause.UNFINISHED_JOB, ScanRow.id.in_(_scans_of_unfinished_jobs()))
    of_these = select(CalibrationRow.scan_id).where(CalibrationRow.id.in_(calibrations_in_use(session)))
    for because, scan_ids in (
        (StaysBecause.ACTIVE_CALIBRATION, set(session.scalars(of_these))),
        (StaysBecause.NEWEST, _newest(session, _newest_log()) | _newest_phantom_scans(session)),
        (
            StaysBecause.SCHEDULE,
            {next_log(session, scanner_id) for scanner_id in _scanners_that_check_drift(session)},
        ),
    ):
        if kept_ids := scan_ids - {None}:
            yield Protection(because, ScanRow.id.in_(kept_ids))


def _of_calibrations(session: Session) -> Iterator[Protection]:
    yield _unfinished(CalibrationRow, job_kinds.CALIBRATE)
    in_use = CalibrationRow.id.in_(calibrations_in_use(session))
    yield Protection(StaysBecause.ACTIVE_CALIBRATION, in_use)
    was_active = exists().where(ActivationRow.calibration_id == CalibrationRow.id)
    yield Protection(StaysBecause.ONCE_ACTIVE, and_(was_active, ~in_use))
    referring = (
        exists().where(table.calibration_id == CalibrationRow.id) for table in (ReconstructionRow, DriftRow, AskedRow)
    )
    yield Protection(StaysBecause.REFERRED_TO, or_(*referring))
    # A schedule knows by it that the newest phantom scan was used.
    yield Protection(StaysBecause.NEWEST, CalibrationRow.scan_id.in_(_newest_phantom_scans(session)))


def _of_drifts(session: Session) -> Iterator[Protection]:
    yield _unfinished(DriftRow, job_kinds.DRIFT)
    # A schedule knows by the newest checks which logs were checked: it continues after the newest of these.
    conditions = []
    for scanner_id in _scanners_that_check_drift(session):
        last = session.scalar(last_looked_at(scanner_id))
        looked_at = exists().where(ScanRow.id == DriftRow.scan_id)
        since = looked_at if last is None else looked_at.where(ScanRow.created_at >= last)
        conditions.append(and_(DriftRow.scanner_id == scanner_id, since))
    if conditions:
        yield Protection(StaysBecause.SCHEDULE, or_(*conditions))


def _by_the_rule(kind: RetentionKind, kept_by: KeptBy) -> KeptBy:
    """Return what keeps rows of a kind; a reason that the mill's table lacks ends the removal before it begins."""

    def protections(session: Session) -> Iterator[Protection]:
        for each in kept_by(session):
            if each.because not in STAYS[kind]:
                msg = f"{kind} are kept as {each.because}, which sawmill_mill.retention.STAYS does not name"
                raise LookupError(msg)
            yield each

    return protections


def _of_events(session: Session) -> Iterator[Protection]:
    if numbers := _newest(session, newest_accepted(EventRow.number)):
        yield Protection(StaysBecause.NEWEST, EventRow.number.in_(numbers))


def _unfinished(table: type[Answered], kind: JobKind) -> Protection:
    unfinished = select(JobRow.id).where(_UNFINISHED, JobRow.kind == kind)
    return Protection(StaysBecause.UNFINISHED_JOB, table.job_id.in_(unfinished))


def _scans_of_unfinished_jobs() -> Select[str]:
    """Select the scans that a job reads or will read, by jobs, of which few have not ended."""
    read = [select(JobRow.subject_id.label("scan_id")).where(_UNFINISHED, JobRow.kind == job_kinds.INGEST)]
    for table in {table_of(declared.kind): None for declared in asked_kinds()}:
        if "scan_id" in table.own_columns():
            scan_id = table.__table__.c.scan_id
            about = select(scan_id).join(JobRow, JobRow.id == table.job_id)
            read.append(about.where(_UNFINISHED, scan_id.is_not(None)))
    return select(union_all(*read).subquery().c.scan_id)


def _newest(session: Session, of_scanner: Select[Found]) -> set[Found]:
    """Read the results of a statement about each scanner, where there is one."""
    statement = select(of_scanner.correlate(ScannerRow).scalar_subquery()).select_from(ScannerRow)
    return {value for value in session.scalars(statement) if value is not None}


def _newest_phantom_scans(session: Session) -> set[str]:
    return _newest(session, newest_phantom_scan(ScannerRow.id))


def _newest_log() -> Select[str]:
    logs = select(ScanRow.id).where(ScanRow.scanner_id == ScannerRow.id, ScanRow.phantom_id.is_(None))
    return logs.where(ScanRow.state == ScanState.READY).order_by(ScanRow.created_at.desc(), ScanRow.id.desc()).limit(1)


def _scanners_that_check_drift(session: Session) -> list[str]:
    checking = select(ScheduleRow.scanner_id).where(ScheduleRow.kind == "check-drift")
    return sorted(set(session.scalars(checking)))


def _forget_calibrations(session: Session, identifiers: Sequence[str]) -> None:
    runs = update(ScheduleRunRow).where(ScheduleRunRow.calibration_id.in_(identifiers))
    session.execute(runs.values(calibration_id=None).execution_options(synchronize_session=False))


def _stock(kind: RetentionKind, job: JobKind, table: type[Any], kept_by: KeptBy | None = None) -> Stock:
    """Return the stock of a table; by default, rows are kept while their jobs have not ended."""
    owner = table.scanner_id, ScannerRow.id
    return Stock(kind, job, table, owner, _by_the_rule(kind, kept_by or (lambda _: [_unfinished(table, job)])))


events_kept_by = _by_the_rule(RetentionKind.EVENTS, _of_events)
"""What keeps events."""
_LOGS = _stock(RetentionKind.LOG_SCANS, job_kinds.INGEST, ScanRow, _of_scans)
_PHANTOM_SCANS = _stock(RetentionKind.PHANTOM_SCANS, job_kinds.INGEST, ScanRow, _of_scans)
_CALIBRATIONS = _stock(RetentionKind.CALIBRATIONS, job_kinds.CALIBRATE, CalibrationRow, _of_calibrations)
_INSPECTIONS = _stock(RetentionKind.INSPECTIONS, job_kinds.INSPECT, AskedRow)
_INSPECTED = exists().where(JobRow.id == AskedRow.job_id, JobRow.kind == job_kinds.INSPECT)
STOCKS: dict[str, Stock] = {
    stock.kind: stock
    for stock in (
        replace(_LOGS, which=(ScanRow.phantom_id.is_(None),)),
        replace(_PHANTOM_SCANS, which=(ScanRow.phantom_id.is_not(None),), jobs_stay=True),  # alarms need the jobs
        _stock(RetentionKind.RECONSTRUCTIONS, job_kinds.RECONSTRUCT, ReconstructionRow),
        replace(_CALIBRATIONS, forget=_forget_calibrations),
        _stock(RetentionKind.DRIFTS, job_kinds.DRIFT, DriftRow, _of_drifts),
        replace(_INSPECTIONS, which=(_INSPECTED,)),
    )
}
"""All kinds but events, which have numbers and no jobs of their own."""
