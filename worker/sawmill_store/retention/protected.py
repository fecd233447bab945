"""Conditions on the rows of a kind for each reason of `sawmill_mill.retention`, evaluated before a removal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from sqlalchemy import ColumnElement, Row, Select, and_, exists, or_, select, true, union_all
from sqlalchemy.orm import Session

from sawmill_contracts import job_kinds
from sawmill_contracts.kinds import asked_kinds
from sawmill_contracts.retention import RetentionKind, StaysBecause
from sawmill_contracts.scans import ScanState
from sawmill_mill.retention import STAYS, stays_because
from sawmill_platform.contracts.jobs import UNFINISHED
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_store.activations import active_calibration
from sawmill_store.alarms import newest_accepted
from sawmill_store.retention.retention_rules import STOCKS, Stock
from sawmill_store.scheduled import last_looked_at, newest_phantom_scan, next_log
from sawmill_store.tables import (
    ActivationRow,
    AskedRow,
    CalibrationRow,
    DriftRow,
    ReconstructionRow,
    ScannerRow,
    ScanRow,
    ScheduleRow,
    table_of,
)

Found = TypeVar("Found", str, int)

_UNFINISHED = JobRow.state.in_(UNFINISHED)


class Protection(NamedTuple):
    """A reason, and the condition that is true for the rows that stay for this reason."""

    because: StaysBecause
    condition: ColumnElement[bool]


def protections(session: Session, kind: RetentionKind) -> list[Protection]:
    """Return the protections of a kind, as of this transaction. No condition is unknown (NULL) for any row."""
    return [each for each in _OF_KIND[kind](session) if each.because in STAYS[kind]]


def may_go(session: Session, kind: RetentionKind, rows: Select[Any]) -> Iterator[Row[Any]]:
    """Yield the rows of a statement on the table of a kind that no reason keeps."""
    kept = protections(session, kind)
    facts = [each.condition.label(f"fact_{number}") for number, each in enumerate(kept)]
    for row in session.execute(rows.add_columns(*facts)):
        reasons = {each.because for each, is_true in zip(kept, row[-len(kept) :], strict=True) if is_true}
        if not stays_because(kind, reasons):
            yield row


def none_of(kept: Sequence[Protection]) -> ColumnElement[bool]:
    """Return the condition that nothing keeps a row."""
    return and_(true(), *(~each.condition for each in kept))


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
    yield _unfinished(STOCKS[RetentionKind.CALIBRATIONS])
    in_use = CalibrationRow.id.in_(calibrations_in_use(session))
    yield Protection(StaysBecause.ACTIVE_CALIBRATION, in_use)
    was_active = exists().where(ActivationRow.calibration_id == CalibrationRow.id)
    yield Protection(StaysBecause.ONCE_ACTIVE, and_(was_active, ~in_use))
    referring = (
        exists().where(table.calibration_id == CalibrationRow.id) for table in (ReconstructionRow, DriftRow, AskedRow)
    )
    yield Protection(StaysBecause.REFERRED_TO, or_(*referring))
    yield Protection(StaysBecause.NEWEST, CalibrationRow.scan_id.in_(_newest_phantom_scans(session)))


def _of_drifts(session: Session) -> Iterator[Protection]:
    yield _unfinished(STOCKS[RetentionKind.DRIFTS])
    conditions = []
    for scanner_id in _scanners_that_check_drift(session):
        last = session.scalar(last_looked_at(scanner_id))
        looked_at = exists().where(ScanRow.id == DriftRow.scan_id)
        since = looked_at if last is None else looked_at.where(ScanRow.created_at >= last)
        conditions.append(and_(DriftRow.scanner_id == scanner_id, since))
    if conditions:
        yield Protection(StaysBecause.SCHEDULE, or_(*conditions))


def _of_events(session: Session) -> Iterator[Protection]:
    if numbers := _newest(session, newest_accepted(EventRow.number)):
        yield Protection(StaysBecause.NEWEST, EventRow.number.in_(numbers))


def _unfinished(stock: Stock) -> Protection:
    unfinished = select(JobRow.id).where(_UNFINISHED, JobRow.kind == stock.job)
    return Protection(StaysBecause.UNFINISHED_JOB, stock.table.job_id.in_(unfinished))


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


_OF_KIND: Mapping[RetentionKind, Callable[[Session], Iterator[Protection]]] = {
    RetentionKind.LOG_SCANS: _of_scans,
    RetentionKind.PHANTOM_SCANS: _of_scans,
    RetentionKind.RECONSTRUCTIONS: lambda _: iter([_unfinished(STOCKS[RetentionKind.RECONSTRUCTIONS])]),
    RetentionKind.CALIBRATIONS: _of_calibrations,
    RetentionKind.DRIFTS: _of_drifts,
    RetentionKind.INSPECTIONS: lambda _: iter([_unfinished(STOCKS[RetentionKind.INSPECTIONS])]),
    RetentionKind.EVENTS: _of_events,
}
