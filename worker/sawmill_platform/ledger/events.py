"""Events with their actors, written in the transaction of the change itself; `event_reader.py` reads new ones."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any, NamedTuple

import structlog
from sqlalchemy import and_, func, inspect, select, true
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import JOB_ENDS, EventType
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.database import clock
from sawmill_platform.database.database import AFTER_COMMIT, StorePart
from sawmill_platform.database.paging import found
from sawmill_platform.database.tables import EventClass, EventRow, JobRow, Json
from sawmill_platform.ledger.event_reader import EventReader, newest_number, published


@dataclass(frozen=True)
class Actor:
    """A person or program that acts, with the name that the audit and the jobs show."""

    name: str  # name of the key, or another name of the actor
    key_id: str | None = None  # id of the key; None: no key
    address: str | None = None  # address from which the request came; None: there is no request
    request_id: str | None = None  # id of the request
    of_service: bool = False  # True if the service acts by itself


THE_SERVICE = Actor("the service", of_service=True)
_ACTING = ContextVar("acting", default=THE_SERVICE)


def actor() -> Actor:
    """Return the actor of this thread or task; the service itself if none is set."""
    return _ACTING.get()


@contextmanager
def acting_as(somebody: Actor) -> Iterator[None]:
    """Set the actor within the block, and in the threads and tasks that the block starts with its context."""
    token = _ACTING.set(somebody)
    try:
        yield
    finally:
        _ACTING.reset(token)


# Key in the detail of an attempt's end, if the attempt reported the value.
PEAK_MEMORY = "peak_memory_bytes"
# Number of newest events that are searched for a worker's last one: a busy machine writes as many in ten minutes.
_NEWEST = 2000
# Skipped by a restore. A busy service writes some 30 000 events a day, and a backup is younger than a month.
NUMBERS_SKIPPED = 1_000_000
_OF_NO_ATTEMPT = (event_kinds.QUEUED, event_kinds.CANCEL_REQUESTED, event_kinds.JOB_CANCELLED)


def record(session: Session, now: datetime, what: EventType, job: JobRow, detail: Json | None = None) -> EventRow:
    """Add an event of a job or an attempt; the actor of a job's end is its client, or the actor that cancelled it.

    Parameters
    ----------
    session, now
        The transaction of the change, and its time.
    what
        The kind of event.
    job
        The job.
    detail
        Further data, short; the sentence of a failure is in `detail`.
    """
    declared = declaration_of(job.kind)
    row = EventRow(
        at=now,
        type=what,
        topic=declared.topic if what in JOB_ENDS and job.group_id else None,
        group_id=job.group_id or None,
        subject=declared.noun,
        subject_id=job.subject_id,
        job_id=job.id,
        attempt=job.attempt or None,
        worker=job.worker,
        why=(detail or {}).get("detail"),
        detail=detail,
    )
    row.who, row.key_id = _canceller(session, job) if what is event_kinds.CANCELLED else (job.asked_by, job.key_id)
    return _write(session, row)


def _canceller(session: Session, job: JobRow) -> tuple[str | None, str | None]:
    """Return the name and the key's id of the actor that cancelled a job."""
    decisions = select(EventRow.who, EventRow.key_id).where(
        EventRow.job_id == job.id, EventRow.type == event_kinds.JOB_CANCELLED
    )
    found = session.execute(decisions.order_by(EventRow.number.desc()).limit(1)).one_or_none()
    return (None, None) if found is None else (found.who, found.key_id)


def record_restored(session: Session, now: datetime, detail: dict[str, Any]) -> None:
    """Add that a backup was restored, under a number that no event after the backup had."""
    number = newest_number(session) + NUMBERS_SKIPPED
    session.add(EventRow(number=number, at=now, type=event_kinds.RESTORED, detail=detail))
    session.flush()


def announce(
    session: Session,
    now: datetime,
    what: EventType,
    subject: str,
    subject_id: str,
    *,
    group_id: str | None = None,
    job_id: str | None = None,
    detail: dict[str, Any] | None = None,
    decided: Mapping[str, Any] | None = None,
    why: str | None = None,
) -> None:
    """Add an event of anything but an attempt at a job, by the actor.

    Parameters
    ----------
    session, now
        The transaction of the change, and its time.
    what
        The kind of event.
    subject, subject_id
        The object of the event: `key` and its id, for example.
    group_id
        The group that the event concerns.
    job_id
        The job that the event concerns.
    detail
        Further data, short: events are sent to all followers.
    decided
        Data of a decision for the audit, which only administrators read.
    why
        Sentence for the history; by default the `reason` of the detail.
    """
    by = actor()
    row = EventRow(
        at=now,
        event_class=EventClass.DECISION if what.is_decision else EventClass.WORK,
        type=what,
        topic=None if group_id is None else what.topic,
        group_id=group_id,
        subject=subject,
        subject_id=subject_id,
        job_id=job_id,
        who=by.name,
        key_id=by.key_id,
        address=by.address,
        request_id=by.request_id,
        why=why or (detail or {}).get("reason"),
        detail=detail,
        decided=None if decided is None else dict(decided),
    )
    _write(session, row)


def _write(session: Session, row: EventRow) -> EventRow:
    """Add a row, and log it once it is committed."""
    session.add(row)
    session.info.setdefault(AFTER_COMMIT, []).append(partial(_log, row))
    return row


def _log(row: EventRow) -> None:
    """Log an event; commands, which print their answer, do not log."""
    if (
        row.type.is_public and structlog.is_configured() and inspect(row).persistent
    ):  # a part of the transaction may have been undone
        structlog.get_logger().info("event", **Event.of_row(row).model_dump(mode="json", exclude_none=True))


class JobNumbers(NamedTuple):
    """Numbers of a job's newest events."""

    latest: int  # number of the last event before the job's end; 0: there is none
    # Number of the event that ended the job; None: it has not ended, or ended when events were not written yet.
    end: int | None


class Events(StorePart):
    """Store of events."""

    def of_job(self, job_id: str) -> list[Event]:
        """Return the events of a job's attempts, the oldest first, or raise `NotFound`."""
        with self._database.read() as session:
            found(session, JobRow, "job", job_id)
            of_attempts = select(EventRow).where(EventRow.job_id == job_id, EventRow.type.not_in(_OF_NO_ATTEMPT))
            return [Event.of_row(row) for row in session.scalars(of_attempts.order_by(EventRow.number))]

    def numbers_of_job(self, job_id: str) -> JobNumbers:
        """Return the numbers of a job's newest events; a job that is read afterwards is as new as these, or newer."""
        newest = select(EventRow.number, EventRow.type).where(EventRow.job_id == job_id, published())
        with self._database.read() as session:
            rows = list(session.execute(newest.order_by(EventRow.number.desc()).limit(2)))
        end = rows.pop(0).number if rows and rows[0].type in JOB_ENDS else None
        return JobNumbers(rows[0].number if rows else 0, end)

    def following(
        self, number: int, *, through: int | None = None, group_id: str | None = None, limit: int = 500
    ) -> list[Event]:
        """Return events behind a number, the oldest first; `EventReader` has the number through which all are written.

        Parameters
        ----------
        number
            Number of the last event before the first one.
        through
            Number of the last event; null: no last one.
        group_id
            Group that the events concern; null: all events.
        limit
            Largest number of events.
        """
        until = true() if through is None else EventRow.number <= through
        of_group = true() if group_id is None else EventRow.group_id == group_id
        wanted = select(EventRow).where(EventRow.number > number, published(), until, of_group)
        wanted = wanted.order_by(EventRow.number).limit(limit)
        with self._database.read() as session:
            return [Event.of_row(row) for row in session.scalars(wanted)]

    def newest_number(self) -> int:
        """Return the number of the newest written event; 0: there is none."""
        with self._database.read() as session:
            return newest_number(session)

    def reader(self) -> EventReader:
        """Return a reader of the events that are added from now on."""
        return EventReader(self._database)

    def workers_since(self, since: datetime) -> dict[str, datetime]:
        """Return workers that started or ended an attempt since then, each with the last time; the latest first."""
        newest = select(EventRow.worker, EventRow.at, EventRow.job_id).order_by(EventRow.number.desc()).limit(_NEWEST)
        lately = newest.subquery()
        named = and_(lately.c.at >= since, lately.c.worker.is_not(None), lately.c.job_id.is_not(None))
        last = func.max(lately.c.at).label("last")
        by_worker = select(lately.c.worker, last).where(named).group_by(lately.c.worker).order_by(last.desc())
        with self._database.read() as session:
            return {row.worker: row.last for row in session.execute(by_worker)}

    def clock_off(self, worker: str, off_s: float) -> None:
        """Add that a process's clock is ahead (or behind, below 0) by this number of seconds."""
        with self._database.write() as session:
            self._add_of_clock(session, event_kinds.CLOCK_OFF, worker, off_s)

    def step_clock(self, worker: str, off_s: float) -> None:
        """Adopt a lasting step of the clock of the process that owns the time."""
        with self._database.write() as session:
            self._add_of_clock(session, event_kinds.CLOCK_STEPPED, worker, off_s)
            clock.set_to(session, clock.machine_offset_s())
        self._database.clock.refresh()

    def of_clock(self) -> list[Event]:
        """Return the events of clocks, the oldest first."""
        kinds = [event_kinds.CLOCK_OFF, event_kinds.CLOCK_STEPPED]
        with self._database.read() as session:
            rows = session.scalars(select(EventRow).where(EventRow.type.in_(kinds)).order_by(EventRow.number))
            return [Event.of_row(row) for row in rows]

    def _add_of_clock(self, session: Session, what: EventType, worker: str, off_s: float) -> None:
        _write(session, EventRow(at=self._database.now(), type=what, worker=worker, detail={"off_s": round(off_s, 3)}))
