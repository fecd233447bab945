"""Events, written in the transaction of the change itself; `ledger/event_reader.py` follows them."""

from collections.abc import Mapping
from datetime import datetime
from functools import partial
from typing import Any, NamedTuple

import structlog
from sqlalchemy import and_, func, inspect, select
from sqlalchemy.orm import Session

from sawmill_platform.acting import actor
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import JOB_ENDS, EventKind
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.kinds import declaration_of
from sawmill_platform.database import clock
from sawmill_platform.database.database import AFTER_COMMIT, Database
from sawmill_platform.database.paging import found
from sawmill_platform.database.tables import EventClass, EventRow, JobRow, Json
from sawmill_platform.ledger.event_reader import EventReader, published, read_event

# In the detail of an attempt's end, where the attempt could tell it.
PEAK_MEMORY = "peak_memory_bytes"
# Among which a worker's last is looked for: a busy machine writes about as many in ten minutes.
_NEWEST = 2000
# By a restore. A mill with 2 000 logs a day writes some 30 000 events a day, and a backup is younger than a month.
NUMBERS_SKIPPED = 1_000_000
_OF_NO_ATTEMPT = (event_kinds.QUEUED, event_kinds.CANCEL_REQUESTED, event_kinds.JOB_CANCELLED)


def record(session: Session, now: datetime, what: EventKind, job: JobRow, detail: Json | None = None) -> EventRow:
    """Add an event of a job or of its attempt; its end is by whoever asked for the job, or cancelled it.

    Parameters
    ----------
    session, now
        The transaction of the change, and its time.
    what
        The kind of event.
    job
        The job.
    detail
        More about it, of few words; the sentence of a failure is in `detail`.
    """
    declared = declaration_of(job.kind)
    row = EventRow(
        at=now,
        what=what,
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
    """Return the name and the key's id of whoever cancelled a job."""
    decisions = select(EventRow.who, EventRow.key_id).where(
        EventRow.job_id == job.id, EventRow.what == event_kinds.JOB_CANCELLED
    )
    found = session.execute(decisions.order_by(EventRow.number.desc()).limit(1)).one_or_none()
    return (None, None) if found is None else (found.who, found.key_id)


def record_restored(session: Session, now: datetime, detail: dict[str, Any]) -> None:
    """Add that a backup was restored, under a number that no event had that was written after the backup."""
    newest = session.scalar(select(func.max(EventRow.number))) or 0
    session.add(EventRow(number=newest + NUMBERS_SKIPPED, at=now, what=event_kinds.RESTORED, detail=detail))
    session.flush()


def announce(
    session: Session,
    now: datetime,
    what: EventKind,
    subject: str,
    subject_id: str,
    *,
    group_id: str | None = None,
    job_id: str | None = None,
    detail: dict[str, Any] | None = None,
    decided: Mapping[str, Any] | None = None,
    why: str | None = None,
) -> None:
    """Add an event of anything but an attempt at a job, by whoever acts.

    Parameters
    ----------
    session, now
        The transaction of the change, and its time.
    what
        The kind of event.
    subject, subject_id
        What it happened to: `key` and its id.
    group_id
        The group that it concerns.
    job_id
        The job that it concerns.
    detail
        More about it, of few words: events are sent to whoever follows them.
    decided
        What the audit keeps of a decision, and administrators alone read.
    why
        For the history: a sentence, by default the `reason` of the detail.
    """
    by = actor()
    row = EventRow(
        at=now,
        event_class=EventClass.DECISION if what.is_decision else EventClass.WORK,
        what=what,
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
    """Log an event; commands, which print their answer, have no log."""
    if (
        row.what.is_public and structlog.is_configured() and inspect(row).persistent
    ):  # a part of the transaction may have been undone
        structlog.get_logger().info("event", **read_event(row).model_dump(mode="json", exclude_none=True))


class JobNumbers(NamedTuple):
    """Of a job's newest events.

    Attributes
    ----------
    latest : int
        Of the last one before the job's end; 0: there is none.
    end : int or None
        Of the one that ended it; None: it has not ended, or ended when events were not written yet.
    """

    latest: int
    end: int | None


class Events:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def of_job(self, job_id: str) -> list[Event]:
        """What happened to a job's attempts, the oldest first, or `NotFound`."""
        with self._database.read() as session:
            found(session, JobRow, "job", job_id)
            of_attempts = select(EventRow).where(EventRow.job_id == job_id, EventRow.what.not_in(_OF_NO_ATTEMPT))
            return [read_event(row) for row in session.scalars(of_attempts.order_by(EventRow.number))]

    def numbers_of_job(self, job_id: str) -> JobNumbers:
        """Of a job's newest events; a job that is read after them is as new as they are, or newer."""
        newest = select(EventRow.number, EventRow.what).where(EventRow.job_id == job_id, published())
        with self._database.read() as session:
            rows = list(session.execute(newest.order_by(EventRow.number.desc()).limit(2)))
        end = rows.pop(0).number if rows and rows[0].what in JOB_ENDS else None
        return JobNumbers(rows[0].number if rows else 0, end)

    def following(
        self, number: int, *, through: int | None = None, group_id: str | None = None, limit: int = 500
    ) -> list[Event]:
        """Events behind a number, the oldest first; `EventReader` tells through which one all of them are written.

        Parameters
        ----------
        number
            Of the last event before them.
        through
            The last number that is wanted; null: no last one.
        group_id
            Those that concern this group; null: all.
        limit
            How many at most.
        """
        wanted = select(EventRow).where(EventRow.number > number, published()).order_by(EventRow.number).limit(limit)
        if through is not None:
            wanted = wanted.where(EventRow.number <= through)
        if group_id is not None:
            wanted = wanted.where(EventRow.group_id == group_id)
        with self._database.read() as session:
            return [read_event(row) for row in session.scalars(wanted)]

    def newest_number(self) -> int:
        """Of the newest event that is written; 0: there is none."""
        with self._database.read() as session:
            return session.scalar(select(func.max(EventRow.number))) or 0

    def reader(self) -> EventReader:
        """Reads what happens from now on."""
        return EventReader(self._database)

    def workers_since(self, since: datetime) -> dict[str, datetime]:
        """Workers that began or ended an attempt since then, each with the last time; the latest first."""
        newest = select(EventRow.worker, EventRow.at, EventRow.job_id).order_by(EventRow.number.desc()).limit(_NEWEST)
        lately = newest.subquery()
        named = and_(lately.c.at >= since, lately.c.worker.is_not(None), lately.c.job_id.is_not(None))
        last = func.max(lately.c.at).label("last")
        by_worker = select(lately.c.worker, last).where(named).group_by(lately.c.worker).order_by(last.desc())
        with self._database.read() as session:
            return {row.worker: row.last for row in session.execute(by_worker)}

    def clock_off(self, worker: str, off_s: float) -> None:
        """Say that a process's clock is ahead (or behind, below 0) by this."""
        with self._database.write() as session:
            self._add_of_clock(session, event_kinds.CLOCK_OFF, worker, off_s)

    def step_clock(self, worker: str, off_s: float) -> None:
        """Take over a lasting step of the clock of the process that owns the time."""
        with self._database.write() as session:
            self._add_of_clock(session, event_kinds.CLOCK_STEPPED, worker, off_s)
            clock.set_to(session, clock.machine_offset_s())
        self._database.clock.refresh()

    def of_clock(self) -> list[Event]:
        """What happened to clocks, the oldest first."""
        kinds = [event_kinds.CLOCK_OFF, event_kinds.CLOCK_STEPPED]
        with self._database.read() as session:
            rows = session.scalars(select(EventRow).where(EventRow.what.in_(kinds)).order_by(EventRow.number))
            return [read_event(row) for row in rows]

    def _add_of_clock(self, session: Session, what: EventKind, worker: str, off_s: float) -> None:
        row = EventRow(at=self._database.now(), what=what, worker=worker, detail={"off_s": round(off_s, 3)})
        _write(session, row)
