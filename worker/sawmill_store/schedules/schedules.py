"""Schedules: each due time is run exactly once, however many processes check for due times.

A schedule queues a job for one of the candidates, by the rules of `sawmill_mill.schedules`.
"""

from contextlib import suppress
from datetime import datetime
from typing import Any, NamedTuple

import structlog
from pydantic import ValidationError
from sqlalchemy import Select, exists, select, true, update
from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.choices import ScheduleOutcome
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_contracts.schedules import Schedule, ScheduleRun, ScheduleSpec
from sawmill_mill import schedules
from sawmill_platform.contracts.base import Page, placed_complaint
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import Check, accept_any, found, narrowed, new_id, read_page, refuse_taken
from sawmill_platform.database.tables import JobRow
from sawmill_platform.due_times import latest_due, next_due
from sawmill_platform.errors import Invalid, StorageError, StorageFull, StorageUnavailable
from sawmill_platform.ledger.audit import changed
from sawmill_platform.ledger.events import Actor, acting_as, announce
from sawmill_store.activations import ScannerId, active_calibration_id
from sawmill_store.mill_tables import (
    CalibrationRow,
    DriftRow,
    PhantomRow,
    ScannerRow,
    ScanRow,
    ScheduleRow,
    ScheduleRunRow,
)
from sawmill_store.requests.asked import Asked
from sawmill_store.scanners.history import changes_in_words
from sawmill_vocabulary import ObjectTurns


class Schedules:
    """Store of schedules: every method is one transaction; `run_due` is one for each due schedule.

    Parameters
    ----------
    database
        Database of the rows.
    calibrations, drifts
        Stores in which due schedules queue their requests.
    """

    def __init__(
        self, database: Database, calibrations: Asked[CalibrationRequest, Any], drifts: Asked[DriftRequest, Any]
    ) -> None:
        self._database = database
        self._calibrations = calibrations
        self._drifts = drifts
        self._looked_at: datetime | None = None

    def create(self, spec: ScheduleSpec, *, schedule_id: str | None = None) -> Schedule:
        """Add a schedule.

        Raises
        ------
        Invalid, NotFound, Conflict
            The cron expression or its time zone is wrong, the scanner's logs are turned between passages and tell no
            drift, there is no such scanner, or the id is taken.
        """
        now = self._database.now()
        row = ScheduleRow(id=schedule_id or new_id(), created_at=now)
        _describe(row, spec, now)
        with self._database.write() as session:
            refuse_taken(session, ScheduleRow, "schedule", row.id)
            _check_scanner(session, spec)
            session.add(row)
            _announce(session, now, mill_events.SCHEDULE_CREATED, row, decided=spec.model_dump(mode="json"))
            session.flush()
            return read_schedule(session, row)

    def get(self, schedule_id: str) -> Schedule:
        """Return a schedule, or raise `NotFound`."""
        with self._database.read() as session:
            return read_schedule(session, found(session, ScheduleRow, "schedule", schedule_id))

    def page(self, *, scanner_id: str | None = None, after: str | None = None, limit: int = 50) -> Page[Schedule]:
        """Return a page of schedules, newest first."""
        statement = narrowed(select(ScheduleRow), {ScheduleRow.scanner_id: scanner_id})
        with self._database.read() as session:
            return read_page(
                session, statement, ScheduleRow, lambda row: read_schedule(session, row), after=after, limit=limit
            )

    def update(self, schedule_id: str, spec: ScheduleSpec, *, check: Check[Schedule] = accept_any) -> Schedule:
        """Replace a schedule, which is due next at the first time of the new expression from now on.

        A due time that has passed and was not run stays due if cron, time zone and `enabled` stay; else it is missed.
        """
        with self._database.write() as session:
            row = found(session, ScheduleRow, "schedule", schedule_id, lock=True)
            check(read_schedule(session, row))
            _check_scanner(session, spec)
            before, now = _spec(row), self._database.now()
            pending = row.next_due_at if row.next_due_at is not None and row.next_due_at <= now else None
            same_times = spec.enabled and (spec.cron, spec.time_zone) == (row.cron, row.time_zone)
            _describe(row, spec, now)
            row.missed = False
            if pending is not None and same_times:
                row.next_due_at = pending
            elif pending is not None:
                _announce_missed(session, row, now, pending, "the schedule was changed before it ran")
            difference = changed(before, _spec(row))
            why = changes_in_words(difference)
            _announce(session, now, mill_events.SCHEDULE_CHANGED, row, decided=difference, why=why)
            session.flush()
            return read_schedule(session, row)

    def delete(self, schedule_id: str) -> None:
        """Remove a schedule and the list of runs; the calibrations stay."""
        with self._database.write() as session:
            row = found(session, ScheduleRow, "schedule", schedule_id, lock=True)
            _announce(session, self._database.now(), mill_events.SCHEDULE_DELETED, row, decided=_spec(row))
            session.delete(row)

    def runs(self, schedule_id: str, *, limit: int = 50) -> list[ScheduleRun]:
        """Return the outcomes of a schedule's due times, newest first."""
        with self._database.read() as session:
            found(session, ScheduleRow, "schedule", schedule_id)
            return _runs(session, schedule_id, limit)

    def run_due(self) -> list[ScheduleRun]:
        """Run every schedule that is due, and set each to its next due time.

        A schedule that was due several times while nothing ran is run once, for the latest due time. A schedule that
        cannot be run is announced as missed the first time, with the reason; the other schedules run nevertheless.

        Raises
        ------
        StorageFull, StorageUnavailable
            Nothing can be written; the schedules stay due.
        """
        now = self._database.now()
        # Due times are computed again at the first check and after the clock was set back, so that none is skipped.
        if self._looked_at is None or now < self._looked_at:
            ahead = select(ScheduleRow).where(ScheduleRow.enabled, ScheduleRow.next_due_at > now)
            with self._database.write() as session:
                for row in session.scalars(ahead).all():
                    with suppress(Invalid):  # which is announced when it is due
                        _moved_on(session, row, now)
        self._looked_at = now
        due = select(ScheduleRow.id).where(ScheduleRow.enabled, ScheduleRow.next_due_at <= now)
        with self._database.read() as session:
            identifiers = session.scalars(due).all()
        runs = list[ScheduleRun | None]()
        for schedule_id in identifiers:
            with acting_as(Actor(f"schedule {schedule_id}", of_service=True)):
                try:
                    runs.append(self._run(schedule_id, now))
                except (StorageFull, StorageUnavailable):
                    raise
                except Exception as error:  # noqa: BLE001 - log and event report it; further schedules are due
                    structlog.get_logger().exception("schedule-not-run", schedule_id=schedule_id)
                    self._miss(schedule_id, now, _in_words(error))
        return [run for run in runs if run is not None]

    def _run(self, schedule_id: str, now: datetime) -> ScheduleRun | None:
        with self._database.write() as session:
            row = session.get(ScheduleRow, schedule_id)
            if row is None or row.next_due_at is None or row.next_due_at > now:
                return None
            first_due_at = row.next_due_at
            if not _moved_on(session, row, now):
                return None
            due_at = latest_due(row.cron, row.time_zone, now)
            # The run exists after an edit, or when the clock was set back.
            statement = select(ScheduleRunRow.number).where(
                ScheduleRunRow.schedule_id == schedule_id, ScheduleRunRow.due_at == due_at
            )
            if session.scalar(statement) is not None:
                return None
            run = ScheduleRun(due_at=due_at, **queue_due(session, self._calibrations, self._drifts, row, now)._asdict())
            session.add(ScheduleRunRow(schedule_id=schedule_id, **run.model_dump()))
            missed = schedules.missed_due_time(first_due_at, due_at, run.outcome, missed_before=row.missed)
            if missed is not None:
                _announce_missed(session, row, now, *missed)
            row.missed = run.outcome in schedules.WHY_NOTHING_WAS_QUEUED
            return run

    def _miss(self, schedule_id: str, now: datetime, reason: str) -> None:
        """Announce a due time that cannot be run, unless the one before was missed too, and set the next due time."""
        with self._database.write() as session:
            row = session.get(ScheduleRow, schedule_id, with_for_update=True)
            if row is None or row.next_due_at is None or row.next_due_at > now:
                return
            due_at = row.next_due_at
            with suppress(Invalid):  # it stays due: another machine may know its time zone
                _moved_on(session, row, now)
            if not row.missed:
                _announce_missed(session, row, now, due_at, reason)
                row.missed = True


def _check_scanner(session: Session, spec: ScheduleSpec) -> None:
    """Lock the schedule's scanner, and refuse drift checks where logs cannot tell."""
    scanner = found(session, ScannerRow, "scanner", spec.scanner_id, lock=True)
    if spec.kind == "check-drift" and scanner.spec["constants"].get("object_turns") == ObjectTurns.BETWEEN_PASSAGES:
        raise Invalid(
            "turned-between-passages",
            f"scanner {scanner.id!r} turns its logs between passages, and they do not tell whether it has moved: "
            "schedule recalibrate",
        )


def _in_words(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return f"its options are not right: {placed_complaint(error)}"
    return str(error) if isinstance(error, StorageError) else f"{type(error).__name__}: {error}"


def _announce(session: Session, now: datetime, what: EventType, row: ScheduleRow, **about: Any) -> None:  # noqa: ANN401
    announce(session, now, what, "schedule", row.id, group_id=row.scanner_id, **about)


def _announce_missed(session: Session, row: ScheduleRow, now: datetime, due_at: datetime, reason: str) -> None:
    _announce(session, now, mill_events.SCHEDULE_MISSED, row, detail={"due_at": due_at.isoformat(), "reason": reason})


def _describe(row: ScheduleRow, spec: ScheduleSpec, now: datetime) -> None:
    next_due_at = next_due(spec.cron, spec.time_zone, now)
    row.scanner_id, row.kind, row.cron, row.time_zone = spec.scanner_id, spec.kind, spec.cron, spec.time_zone
    row.enabled, row.on_pass = spec.enabled, spec.on_pass
    row.options = spec.options.model_dump(mode="json")
    row.drift_options = spec.drift_options.model_dump(mode="json")
    row.next_due_at = next_due_at if spec.enabled else None


def _spec(row: ScheduleRow) -> dict[str, Any]:
    return {name: getattr(row, name) for name in ScheduleSpec.model_fields}


def _moved_on(session: Session, row: ScheduleRow, now: datetime) -> bool:
    """Set the next due time by compare and set: only one of several processes at once succeeds."""
    moved = session.scalar(
        update(ScheduleRow)
        .where(ScheduleRow.id == row.id, ScheduleRow.enabled, ScheduleRow.next_due_at == row.next_due_at)
        .values(next_due_at=next_due(row.cron, row.time_zone, now))
        .returning(ScheduleRow.id)
        .execution_options(synchronize_session=False)
    )
    return moved is not None


def _runs(session: Session, schedule_id: str, limit: int) -> list[ScheduleRun]:
    rows = session.scalars(
        select(ScheduleRunRow)
        .where(ScheduleRunRow.schedule_id == schedule_id)
        .order_by(ScheduleRunRow.due_at.desc())
        .limit(limit)
    )
    return [ScheduleRun.of_row(row) for row in rows]


def read_schedule(session: Session, row: ScheduleRow) -> Schedule:
    """Read the schedule of a row, with its last run."""
    last = _runs(session, row.id, 1)
    return Schedule.of_row(row, last_run=last[0] if last else None)


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
        if active_calibration_id(session, row.scanner_id) is None:
            return Outcome("no-active-calibration")
        scan_id = next_log(session, row.scanner_id)
        if scan_id is None:
            return Outcome("no-new-log-scan")
        # A scan that was uploaded as a mean has no rows to choose from.
        is_mean = found(session, ScanRow, "scan", scan_id).spec.get("averaged_rows") is not None
        ask = DriftRequest(scan_id=scan_id, **row.drift_options | ({"rows": None} if is_mean else {}))
        return Outcome("queued", drift_id=drifts.queue(session, ask, now, priority=Priority.BATCH).id)
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
        .where(ScanRow.scanner_id == scanner_id, ScanRow.phantom_id.is_(None), JobRow.state.not_in(schedules.UNSEEN))
        .order_by(ScanRow.created_at.desc())
        .limit(1)
    )


def next_log(session: Session, scanner_id: str) -> str | None:
    """Choose the log scan that a schedule checks for drift next: none of a log that is turned between passages."""
    constants = found(session, ScannerRow, "scanner", scanner_id).spec["constants"]
    if constants.get("object_turns") == ObjectTurns.BETWEEN_PASSAGES:
        return None
    views, is_checked = ScanRow.reading["shape"]["views"].as_integer(), exists().where(DriftRow.scan_id == ScanRow.id)
    logs = select(ScanRow.id, ScanRow.created_at, ScanRow.state, views, is_checked)
    last = session.scalar(last_looked_at(scanner_id))
    newer = true() if last is None else ScanRow.created_at > last
    logs = logs.where(ScanRow.scanner_id == scanner_id, ScanRow.phantom_id.is_(None), newer)
    narrowed = logs.where(ScanRow.state == ScanState.READY, ~is_checked, views >= schedules.FEWEST_VIEWS)
    newest_first = narrowed.order_by(ScanRow.created_at.desc(), ScanRow.id.desc()).limit(_CANDIDATES)
    return schedules.log_scan_to_check((schedules.LogScan(*row) for row in session.execute(newest_first)), last)


def _recalibrate(
    session: Session, calibrations: Asked[CalibrationRequest, Any], row: ScheduleRow, now: datetime
) -> Outcome:
    """Queue a calibration of the phantom scan that the rule chooses."""
    is_used = exists().where(CalibrationRow.scan_id == ScanRow.id, CalibrationRow.schedule_id.is_not(None))
    columns = ScanRow.id, ScanRow.state, PhantomRow.state, is_used
    newest_first = newest_phantom_scan(row.scanner_id).with_only_columns(*columns).limit(_CANDIDATES)
    scan_id = schedules.phantom_scan_to_use(schedules.PhantomScan(*each) for each in session.execute(newest_first))
    if scan_id is None:
        return Outcome("no-new-phantom-scan")
    ask = CalibrationRequest.model_validate({**row.options, "scan_id": scan_id, "activate": row.on_pass == "activate"})  # noqa: S105 - no password
    queued = calibrations.queue(session, ask, now, given={"schedule_id": row.id}, priority=Priority.BATCH)
    return Outcome("queued", calibration_id=queued.id)
