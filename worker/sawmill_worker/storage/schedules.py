"""Scheduled recalibration: exactly once for each due time, however many processes look."""

from datetime import datetime
from typing import Any

from sqlalchemy import exists, select, update
from sqlalchemy.orm import Session

from sawmill_worker.contracts import calibrations
from sawmill_worker.contracts.audit import AuditAction
from sawmill_worker.contracts.base import Page
from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.contracts.events import EventKind
from sawmill_worker.contracts.jobs import Priority
from sawmill_worker.contracts.phantoms import PhantomState
from sawmill_worker.contracts.scans import ScanState
from sawmill_worker.contracts.schedules import Schedule, ScheduleRun, ScheduleSpec
from sawmill_worker.storage.asked import queue_asked
from sawmill_worker.storage.audit import changed, write_audit
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.due_times import latest_due, next_due
from sawmill_worker.storage.events import announce
from sawmill_worker.storage.paging import found, narrowed, new_id, read_page, refuse_taken
from sawmill_worker.storage.tables import CalibrationRow, PhantomRow, ScannerRow, ScanRow, ScheduleRow, ScheduleRunRow


class Schedules:
    """Every method is one transaction, `run_due` one for each due schedule."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def create(self, spec: ScheduleSpec, *, schedule_id: str | None = None) -> Schedule:
        """Add a schedule.

        Raises
        ------
        Invalid, NotFound, Conflict
            The cron expression or its time zone is wrong, there is no such scanner, or the id is taken.
        """
        now = self._database.now()
        row = ScheduleRow(id=schedule_id or new_id(), created_at=now)
        _describe(row, spec, now)
        with self._database.write() as session:
            refuse_taken(session, ScheduleRow, "schedule", row.id)
            found(session, ScannerRow, "scanner", spec.scanner_id, lock=True)
            session.add(row)
            write_audit(session, now, AuditAction.SCHEDULE_CREATED, row.id, spec.model_dump(mode="json"))
            _announce(session, now, EventKind.SCHEDULE_CREATED, row)
            session.flush()
            return _read(session, row)

    def get(self, schedule_id: str) -> Schedule:
        """One schedule, or `NotFound`."""
        with self._database.read() as session:
            return _read(session, found(session, ScheduleRow, "schedule", schedule_id))

    def page(self, *, scanner_id: str | None = None, after: str | None = None, limit: int = 50) -> Page[Schedule]:
        """Schedules, newest first."""
        statement = narrowed(select(ScheduleRow), {ScheduleRow.scanner_id: scanner_id})
        with self._database.read() as session:
            return read_page(session, statement, ScheduleRow, lambda row: _read(session, row), after=after, limit=limit)

    def update(self, schedule_id: str, spec: ScheduleSpec) -> Schedule:
        """Replace a schedule; it is due next at the first time of its expression from now on."""
        with self._database.write() as session:
            row = found(session, ScheduleRow, "schedule", schedule_id, lock=True)
            found(session, ScannerRow, "scanner", spec.scanner_id, lock=True)
            before, now = _spec(row), self._database.now()
            _describe(row, spec, now)
            write_audit(session, now, AuditAction.SCHEDULE_CHANGED, schedule_id, changed(before, _spec(row)))
            _announce(session, now, EventKind.SCHEDULE_CHANGED, row)
            session.flush()
            return _read(session, row)

    def delete(self, schedule_id: str) -> None:
        """Remove a schedule and the list of its runs; the calibrations stay."""
        with self._database.write() as session:
            row = found(session, ScheduleRow, "schedule", schedule_id, lock=True)
            now = self._database.now()
            write_audit(session, now, AuditAction.SCHEDULE_DELETED, schedule_id, _spec(row))
            _announce(session, now, EventKind.SCHEDULE_DELETED, row)
            session.delete(row)

    def runs(self, schedule_id: str, *, limit: int = 50) -> list[ScheduleRun]:
        """The outcomes of its due times, newest first."""
        with self._database.read() as session:
            found(session, ScheduleRow, "schedule", schedule_id)
            return _runs(session, schedule_id, limit)

    def run_due(self) -> list[ScheduleRun]:
        """Run every schedule whose time has come, and move it on to its next time.

        A schedule that was due several times while nothing ran is run once, for the latest of them.
        """
        now = self._database.now()
        due = select(ScheduleRow.id).where(ScheduleRow.enabled, ScheduleRow.next_due_at <= now)
        with self._database.read() as session:
            identifiers = session.scalars(due).all()
        runs = (self._run(identifier, now) for identifier in identifiers)
        return [run for run in runs if run is not None]

    def _run(self, schedule_id: str, now: datetime) -> ScheduleRun | None:
        with self._database.write() as session:
            row = session.get(ScheduleRow, schedule_id)
            if row is None or row.next_due_at is None or row.next_due_at > now:
                return None
            due_at, first_due_at = latest_due(row.cron, row.time_zone, now), row.next_due_at
            if not _moved_on(session, row, now) or _ran_already(session, schedule_id, due_at):
                return None
            scan = _new_phantom_scan(session, row.scanner_id)
            calibration_id = _queue(session, row, scan, now) if scan is not None else None
            run = ScheduleRun(
                due_at=due_at,
                outcome="no-new-phantom-scan" if scan is None else "queued",
                calibration_id=calibration_id,
            )
            session.add(ScheduleRunRow(schedule_id=schedule_id, **run.model_dump()))
            if first_due_at < due_at:
                _announce_missed(session, row, now, first_due_at, "nothing ran schedules then")
            if scan is None:
                _announce_missed(session, row, now, due_at, "there was no new scan of a phantom")
            return run


def _announce(
    session: Session, now: datetime, what: EventKind, row: ScheduleRow, detail: dict[str, Any] | None = None
) -> None:
    announce(session, now, what, "schedule", row.id, scanner_id=row.scanner_id, detail=detail)


def _announce_missed(session: Session, row: ScheduleRow, now: datetime, due_at: datetime, reason: str) -> None:
    _announce(session, now, EventKind.SCHEDULE_MISSED, row, {"due_at": due_at.isoformat(), "reason": reason})


def _describe(row: ScheduleRow, spec: ScheduleSpec, now: datetime) -> None:
    next_due_at = next_due(spec.cron, spec.time_zone, now)
    row.scanner_id, row.cron, row.time_zone = spec.scanner_id, spec.cron, spec.time_zone
    row.enabled, row.on_pass = spec.enabled, spec.on_pass
    row.options = spec.options.model_dump(mode="json")
    row.next_due_at = next_due_at if spec.enabled else None


def _spec(row: ScheduleRow) -> dict[str, Any]:
    return {name: getattr(row, name) for name in ScheduleSpec.model_fields}


def _moved_on(session: Session, row: ScheduleRow, now: datetime) -> bool:
    """Compare and set: of several processes at once, one moves the schedule on."""
    moved = session.scalar(
        update(ScheduleRow)
        .where(ScheduleRow.id == row.id, ScheduleRow.enabled, ScheduleRow.next_due_at == row.next_due_at)
        .values(next_due_at=next_due(row.cron, row.time_zone, now))
        .returning(ScheduleRow.id)
        .execution_options(synchronize_session=False)
    )
    return moved is not None


def _ran_already(session: Session, schedule_id: str, due_at: datetime) -> bool:
    # After an edit, or when the clock was put back.
    statement = select(ScheduleRunRow.number).where(
        ScheduleRunRow.schedule_id == schedule_id, ScheduleRunRow.due_at == due_at
    )
    return session.scalar(statement) is not None


def _new_phantom_scan(session: Session, scanner_id: str) -> ScanRow | None:
    """The scanner's newest usable phantom scan, unless a schedule has used it: an older one shows the past."""
    newest = session.scalar(
        select(ScanRow)
        .join(PhantomRow, PhantomRow.id == ScanRow.phantom_id)
        .where(ScanRow.scanner_id == scanner_id, ScanRow.state == ScanState.READY)
        .where(PhantomRow.state == PhantomState.READY)
        .order_by(ScanRow.created_at.desc(), ScanRow.id.desc())
        .limit(1)
    )
    if newest is None:
        return None
    used = exists().where(CalibrationRow.scan_id == newest.id, CalibrationRow.schedule_id.is_not(None))
    return None if session.scalar(select(used)) else newest


def _queue(session: Session, row: ScheduleRow, scan: ScanRow, now: datetime) -> str:
    ask = CalibrationAsk.model_validate({**row.options, "scan_id": scan.id, "activate": row.on_pass == "activate"})  # noqa: S105 - no password
    given = {"schedule_id": row.id}
    return queue_asked(session, calibrations.DECLARATION, ask, now, given=given, priority=Priority.BATCH).id


def _runs(session: Session, schedule_id: str, limit: int) -> list[ScheduleRun]:
    rows = session.scalars(
        select(ScheduleRunRow)
        .where(ScheduleRunRow.schedule_id == schedule_id)
        .order_by(ScheduleRunRow.due_at.desc())
        .limit(limit)
    )
    return [
        ScheduleRun.model_validate({"due_at": row.due_at, "outcome": row.outcome, "calibration_id": row.calibration_id})
        for row in rows
    ]


def _read(session: Session, row: ScheduleRow) -> Schedule:
    last = _runs(session, row.id, 1)
    return Schedule.model_validate(
        {
            "id": row.id,
            "created_at": row.created_at,
            "scanner_id": row.scanner_id,
            "cron": row.cron,
            "time_zone": row.time_zone,
            "enabled": row.enabled,
            "on_pass": row.on_pass,
            "options": row.options,
            "next_due_at": row.next_due_at,
            "last_run": last[0] if last else None,
        }
    )
