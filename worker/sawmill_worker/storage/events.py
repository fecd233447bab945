"""What happened to attempts and to the clock, written in the transaction of the change itself."""

from datetime import datetime
from typing import Any

from sqlalchemy import and_, func, select
from sqlalchemy.orm import Session

from sawmill_worker.contracts.events import Event, EventKind
from sawmill_worker.storage import clock
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.paging import found
from sawmill_worker.storage.tables import EventRow, JobRow

# In the detail of an attempt's end, where the attempt could tell it.
PEAK_MEMORY = "peak_memory_bytes"
# Among which a worker's last is looked for: a busy machine writes about as many in ten minutes.
_NEWEST = 2000


def record(session: Session, now: datetime, what: EventKind, job: JobRow, detail: dict[str, Any] | None = None) -> None:
    """Add what happens to a job's attempt."""
    session.add(
        EventRow(at=now, what=what, job_id=job.id, attempt=job.attempt or None, worker=job.worker, detail=detail)
    )


class Events:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def of_job(self, job_id: str) -> list[Event]:
        """What happened to a job's attempts, the oldest first, or `NotFound`."""
        with self._database.read() as session:
            found(session, JobRow, "job", job_id)
            rows = session.scalars(select(EventRow).where(EventRow.job_id == job_id).order_by(EventRow.number))
            return [_read(row) for row in rows]

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
            self._add(session, EventKind.CLOCK_OFF, worker, off_s)

    def step_clock(self, worker: str, off_s: float) -> None:
        """Take over a lasting step of the clock of the process that owns the time."""
        with self._database.write() as session:
            self._add(session, EventKind.CLOCK_STEPPED, worker, off_s)
            clock.set_to(session, clock.machine_offset_s())
        self._database.clock.refresh()

    def of_clock(self) -> list[Event]:
        """What happened to clocks, the oldest first."""
        kinds = [EventKind.CLOCK_OFF, EventKind.CLOCK_STEPPED]
        with self._database.read() as session:
            rows = session.scalars(select(EventRow).where(EventRow.what.in_(kinds)).order_by(EventRow.number))
            return [_read(row) for row in rows]

    def _add(self, session: Session, what: EventKind, worker: str, off_s: float) -> None:
        session.add(EventRow(at=self._database.now(), what=what, worker=worker, detail={"off_s": round(off_s, 3)}))


def _read(row: EventRow) -> Event:
    return Event.model_validate(
        {
            "number": row.number,
            "at": row.at,
            "what": row.what,
            "job_id": row.job_id,
            "attempt": row.attempt,
            "worker": row.worker,
            "detail": row.detail,
        }
    )
