"""Rows that rules of retention may remove, by kind, and what keeps such rows all the same."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any, TypeVar

from sqlalchemy import ColumnElement, Select, and_, delete, exists, func, or_, select, text, true, union_all, update
from sqlalchemy.orm import Session

from sawmill_contracts import kinds
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.retention import RetentionKind
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import UNFINISHED, JobKind
from sawmill_platform.database.tables import REMOVABLE, EventRow, JobDependencyRow, JobRow
from sawmill_store.activations import active_calibration
from sawmill_store.mill_tables import (
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
from sawmill_store.scanners.alarms import newest_accepted
from sawmill_store.schedules.schedules import last_looked_at, newest_phantom_scan, next_log

Found = TypeVar("Found", str, int)

_UNFINISHED = JobRow.state.in_(UNFINISHED)


# What keeps rows, as of a transaction: conditions that are true for the rows that stay, and never unknown (NULL).
Protections = Callable[[Session], Iterable[ColumnElement[bool]]]


@dataclass(frozen=True)
class RemovableRows:
    """The rows of one kind: those of a table that fulfil `which`, what protects them, and the jobs that made them.

    Events have no job, and go by their number. `jobs_stay` if the jobs of removed rows are kept.
    """

    table: type[Any]
    protections: Protections
    which: tuple[Any, ...] = ()
    job: JobKind | None = None
    jobs_stay: bool = False
    batch: int = 50  # files of 230 MB each are deleted within the time of a round

    @property
    def key(self) -> Any:  # noqa: ANN401 - a column
        """Return the column that identifies a row."""
        return EventRow.number if self.table is EventRow else self.table.id

    @property
    def at(self) -> Any:  # noqa: ANN401 - a column
        """Return the column with the age of a row."""
        return EventRow.at if self.table is EventRow else self.table.created_at

    def reached(self, session: Session, days: int, at: datetime) -> ColumnElement[bool]:
        """Return the condition that a row of this kind is older than a number of days at a time."""
        aged = at - timedelta(days=days)
        is_old = EventRow.number <= _last_old_event(session, aged) if self.table is EventRow else self.at <= aged
        return and_(*self.which, is_old)

    def oldest_first(self) -> tuple[Any, ...]:
        """Return the columns in whose order rows are removed."""
        return (self.key,) if self.table is EventRow else (self.at, self.key)

    def unprotected(self, session: Session) -> ColumnElement[bool]:
        """Return the condition that nothing protects a row."""
        return and_(true(), *(~condition for condition in self.protections(session)))


def _last_old_event(session: Session, aged: datetime) -> int:
    """Find the number of the newest event until a time by bisection, for there is no index by time; 0: none.

    The newest event of all is never too old: numbers continue from it.
    """
    ends = (select(least(EventRow.number)).scalar_subquery() for least in (func.min, func.max))
    first, newest = session.execute(select(*ends)).one()
    if first is None:
        return 0
    low, high = first - 1, newest - 1
    while low < high:
        middle = (low + high) // 2
        following = select(EventRow.number, EventRow.at).where(EventRow.number > middle).order_by(EventRow.number)
        number, happened_at = session.execute(following.limit(1)).one()
        if happened_at <= aged:
            low = number
        else:
            high = middle
    return low if low >= first else 0


def _of_scans(session: Session) -> Iterator[ColumnElement[bool]]:
    # The scans that a job reads or will read, by jobs, of which few have not ended.
    read = [select(JobRow.subject_id.label("scan_id")).where(_UNFINISHED, JobRow.kind == kinds.INGEST)]
    for table in {table_of(declared.kind): None for declared in asked_kinds()}:
        if "scan_id" in table.own_columns():
            scan_id = table.__table__.c.scan_id
            about = select(scan_id).join(JobRow, JobRow.id == table.job_id)
            read.append(about.where(_UNFINISHED, scan_id.is_not(None)))
    yield ScanRow.id.in_(select(union_all(*read).subquery().c.scan_id))
    # Each scanner's active calibration and the calibration that was active before.
    active = active_calibration(ScannerRow.id).correlate(ScannerRow)
    before = active.where(ActivationRow.calibration_id != active.scalar_subquery())
    rows = session.execute(select(active.scalar_subquery(), before.scalar_subquery()).select_from(ScannerRow))
    in_use = select(CalibrationRow.scan_id).where(
        CalibrationRow.id.in_({identifier for row in rows for identifier in row if identifier is not None})
    )
    logs = select(ScanRow.id).where(ScanRow.scanner_id == ScannerRow.id, ScanRow.phantom_id.is_(None))
    logs = logs.where(ScanRow.state == ScanState.READY).order_by(ScanRow.created_at.desc(), ScanRow.id.desc())
    kept_ids: set[str | None] = {*session.scalars(in_use), *_newest(session, logs.limit(1))}
    kept_ids |= _newest_phantom_scans(session)
    kept_ids |= {next_log(session, scanner_id) for scanner_id in _scanners_that_check_drift(session)}
    yield ScanRow.id.in_(kept_ids - {None})


def _of_calibrations(session: Session) -> Iterator[ColumnElement[bool]]:
    yield _unfinished(CalibrationRow, kinds.CALIBRATE)
    yield exists().where(ActivationRow.calibration_id == CalibrationRow.id)
    referring = (
        exists().where(table.calibration_id == CalibrationRow.id) for table in (ReconstructionRow, DriftRow, AskedRow)
    )
    yield or_(*referring)
    # A schedule knows by it that the newest phantom scan was used.
    yield CalibrationRow.scan_id.in_(_newest_phantom_scans(session))


def _of_drifts(session: Session) -> Iterator[ColumnElement[bool]]:
    yield _unfinished(DriftRow, kinds.DRIFT)
    # A schedule knows by the newest checks which logs were checked: it continues after the newest of these.
    conditions = []
    for scanner_id in _scanners_that_check_drift(session):
        last = session.scalar(last_looked_at(scanner_id))
        looked_at = exists().where(ScanRow.id == DriftRow.scan_id)
        since = looked_at if last is None else looked_at.where(ScanRow.created_at >= last)
        conditions.append(and_(DriftRow.scanner_id == scanner_id, since))
    if conditions:
        yield or_(*conditions)


def _of_events(session: Session) -> Iterator[ColumnElement[bool]]:
    # An alarm knows by it when the newest scan came, deleted or not.
    yield EventRow.number.in_(_newest(session, newest_accepted(EventRow.number)))


def _unfinished(table: type[Answered], kind: JobKind) -> ColumnElement[bool]:
    return table.job_id.in_(select(JobRow.id).where(_UNFINISHED, JobRow.kind == kind))


def _newest(session: Session, of_scanner: Select[Found]) -> set[Found]:
    """Read the results of a statement about each scanner, where there is one."""
    statement = select(of_scanner.correlate(ScannerRow).scalar_subquery()).select_from(ScannerRow)
    return {value for value in session.scalars(statement) if value is not None}


def _newest_phantom_scans(session: Session) -> set[str]:
    return _newest(session, newest_phantom_scan(ScannerRow.id))


def _scanners_that_check_drift(session: Session) -> list[str]:
    return sorted(set(session.scalars(select(ScheduleRow.scanner_id).where(ScheduleRow.kind == "check-drift"))))


def _rows(job: JobKind, table: type[Any], protections: Protections | None = None) -> RemovableRows:
    """Return the rows of a table; by default, they are kept while their jobs have not ended."""
    return RemovableRows(table, protections or (lambda _: [_unfinished(table, job)]), job=job)


_SCANS = _rows(kinds.INGEST, ScanRow, _of_scans)
_INSPECTED = exists().where(JobRow.id == AskedRow.job_id, JobRow.kind == kinds.INSPECT)
# What may be removed of each kind; rows of other kinds always stay.
REMOVABLE_ROWS: dict[RetentionKind, RemovableRows] = {
    RetentionKind.LOG_SCANS: replace(_SCANS, which=(ScanRow.phantom_id.is_(None),)),
    # Alarms need the jobs.
    RetentionKind.PHANTOM_SCANS: replace(_SCANS, which=(ScanRow.phantom_id.is_not(None),), jobs_stay=True),
    RetentionKind.RECONSTRUCTIONS: _rows(kinds.RECONSTRUCT, ReconstructionRow),
    RetentionKind.CALIBRATIONS: _rows(kinds.CALIBRATE, CalibrationRow, _of_calibrations),
    RetentionKind.DRIFTS: _rows(kinds.DRIFT, DriftRow, _of_drifts),
    RetentionKind.INSPECTIONS: replace(_rows(kinds.INSPECT, AskedRow), which=(_INSPECTED,)),
    RetentionKind.EVENTS: RemovableRows(EventRow, _of_events, which=(text(REMOVABLE),), batch=2000),
}


def lock(session: Session, rows: RemovableRows, keys: Sequence[Any]) -> None:
    """Lock rows against transactions that use or delete them; the scanners to which they belong are locked first.

    A request locks the row that it refers to, and then refers to that row's scanner: that request must not wait for
    this transaction. SQLite has one writer at a time: it needs no locks, and takes none.
    """
    if rows.job is not None:
        mine = ScannerRow.id.in_(select(rows.table.scanner_id).where(rows.key.in_(keys)))
        session.execute(select(ScannerRow.id).where(mine).order_by(ScannerRow.id).with_for_update(key_share=True))
        session.execute(select(rows.key).where(rows.key.in_(keys)).order_by(rows.key).with_for_update())


def delete_rows(session: Session, rows: RemovableRows, keys: Sequence[Any]) -> None:
    """Delete rows with what refers to them, and their jobs unless these stay."""
    which, statements = rows.key.in_(keys), list[Any]()
    if rows.table is CalibrationRow:  # a schedule's run outlasts its calibration
        runs = update(ScheduleRunRow).where(ScheduleRunRow.calibration_id.in_(keys))
        statements.append(runs.values(calibration_id=None))
    statements.append(delete(rows.table).where(which))
    if rows.job is not None and not rows.jobs_stay:
        job_ids = session.scalars(select(rows.table.job_id).where(which)).all()
        waited = or_(JobDependencyRow.job_id.in_(job_ids), JobDependencyRow.needs_job_id.in_(job_ids))
        statements += [delete(JobDependencyRow).where(waited), delete(JobRow).where(JobRow.id.in_(job_ids))]
    for statement in statements:
        session.execute(statement.execution_options(synchronize_session=False))
