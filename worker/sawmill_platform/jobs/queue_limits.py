"""Queueing of a job, and limits on the number of waiting jobs, in all and for each key.

A request takes its place in the transaction that queues the job, one request after the other on PostgreSQL too:
requests that come at once take no more places than there are. Jobs that the service itself queues, for example for a
schedule, and jobs that are queued again for a retry are never refused: they need no place, and count for later
requests.
"""

import math
from collections.abc import Sequence
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import func, literal_column, select, true, update
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobKind, JobState, Priority
from sawmill_platform.database.database import Database, lock_files_of
from sawmill_platform.database.paging import new_id, refuse_taken
from sawmill_platform.database.tables import EventRow, JobDependencyRow, JobRow
from sawmill_platform.errors import QueueFull
from sawmill_platform.jobs.wait_estimate import FIRST_COME, WaitEstimates
from sawmill_platform.ledger.events import actor, record
from sawmill_platform.settings import StorageSettings

_LOCK = "places in the queue"
# Largest time until the next place in a refusal: clients should not retry all the time, nor wait while places are free.
LONGEST_RETRY_S = 300
RETRY_IF_UNKNOWN_S = 60

# Written as a literal: both databases use the partial index of such rows only if the statement contains it.
_QUEUED = JobRow.state == literal_column("'queued'")


class Waiting(NamedTuple):
    """Number of waiting jobs, in all and of the key with most of them; the name is None if no key has any."""

    in_all: int
    most_of_a_key: int
    fullest_key: str | None


class _Full(NamedTuple):
    """A limit that is reached."""

    waits: int
    most: int
    key_id: str | None

    @property
    def sentence(self) -> str:
        if self.key_id is None:
            return f"{self.waits} jobs wait, and {self.most} may in all (SAWMILL_MAX_QUEUED_JOBS)"
        whose = f"of one key may (SAWMILL_MAX_QUEUED_JOBS_PER_KEY), here of {actor().name!r}"
        return f"{self.waits} jobs wait, and {self.most} {whose}"


class Places:
    """Places within the limits of the settings.

    Parameters
    ----------
    database
        Database with the waiting jobs.
    settings
        Settings with `max_queued_jobs` and `max_queued_jobs_per_key`.
    """

    def __init__(self, database: Database, settings: StorageSettings) -> None:
        self._database = database
        self._settings = settings
        self._estimates = WaitEstimates()

    def check(self) -> None:
        """Refuse before a file is sent, if the job would be refused after it.

        Raises
        ------
        QueueFull
            There is no place for the actor.
        """
        with self._database.read() as session:
            full = self._full(session, actor().key_id)
            if full is not None:
                raise self._refusal(session, full)

    def take(self, session: Session, job: JobRow) -> None:
        """Take a place for a job that was queued in this transaction.

        Take the place last: other requests wait for the end of the transaction. A job of the service itself needs no
        place, and its event states so.

        Raises
        ------
        QueueFull
            There is no place.
        """
        if actor().of_service:
            full = self._full(session, None, own=1)
            if full is not None:
                queued = select(EventRow).where(EventRow.job_id == job.id, EventRow.type == event_kinds.QUEUED)
                session.scalars(queued).one().detail = {
                    "reason": f"{full.sentence}: this one is the service's own and waits as well"
                }
            return
        lock_files_of(session, _LOCK)
        full = self._full(session, job.key_id, own=1)
        if full is not None:
            raise self._refusal(session, full)

    def waiting(self) -> Waiting:
        """Return the present number of waiting jobs."""
        by_key = select(func.count(), JobRow.key_id).where(_QUEUED).group_by(JobRow.key_id)
        with self._database.read() as session:
            numbers = [(number, key_id) for number, key_id in session.execute(by_key)]
            most, key_id = max(
                ((number, key_id) for number, key_id in numbers if key_id is not None), default=(0, None)
            )
            one = select(JobRow.asked_by).where(_QUEUED, JobRow.key_id == key_id).limit(1)
            name = None if key_id is None else session.scalar(one)
        return Waiting(sum(number for number, _ in numbers), most, name)

    def _full(self, session: Session, key_id: str | None, *, own: int = 0) -> _Full | None:
        """Return the limit that is reached, the key's own first; `own` of the counted jobs request a place now."""
        in_all, of_a_key = self._settings.max_queued_jobs, self._settings.max_queued_jobs_per_key
        waits = _number(session) - own
        of_key = 0 if key_id is None else _number(session, key_id) - own
        if of_key >= of_a_key:
            return _Full(of_key, of_a_key, key_id)
        return _Full(waits, in_all, None) if waits >= in_all else None

    def _refusal(self, session: Session, full: _Full) -> QueueFull:
        """Return the refusal, with the time until the first waiting job is likely to start."""
        mine = true() if full.key_id is None else JobRow.key_id == full.key_id
        first = select(JobRow).where(_QUEUED, JobRow.not_before_s.is_(None), mine).order_by(*FIRST_COME).limit(1)
        row = session.scalar(first)
        wait_s = None if row is None else self._estimates.wait_s(session, row, self._database.now())
        retry_s = RETRY_IF_UNKNOWN_S if wait_s is None else min(max(1, math.ceil(wait_s)), LONGEST_RETRY_S)
        return QueueFull(f"{full.sentence}: try again in {retry_s} s", retry_s)


def _number(session: Session, key_id: str | None = None) -> int:
    waiting = select(func.count()).select_from(JobRow).where(_QUEUED)
    return session.scalar(waiting if key_id is None else waiting.where(JobRow.key_id == key_id)) or 0


def queue_job(
    session: Session,
    kind: JobKind,
    subject_id: str,
    now: datetime,
    *,
    short: bool,
    group_id: str | None,
    needs: Sequence[str] = (),
    job_id: str | None = None,
    priority: Priority = Priority.INTERACTIVE,
) -> JobRow:
    """Queue a job that starts only when the jobs that it needs have ended.

    Needed jobs that are behind it in the queue are brought forward.
    """
    job_id = job_id or new_id()
    refuse_taken(session, JobRow, "job", job_id)
    asked_by = actor()
    row = JobRow(
        id=job_id,
        created_at=now,
        kind=kind,
        state=JobState.QUEUED,
        subject_id=subject_id,
        priority=priority,
        short=short,
        group_id=group_id or "",
        attempt=0,
        beats=0,
        losses=0,
        outages=0,
        cancel_requested=False,
        request_id=asked_by.request_id,
        key_id=asked_by.key_id,
        asked_by=asked_by.name,
    )
    session.add(row)
    record(session, row.created_at, event_kinds.QUEUED, row)
    session.flush()
    session.add_all(JobDependencyRow(job_id=job_id, needs_job_id=needed) for needed in needs)
    _bring_forward(session, needs, priority)
    return row


def _bring_forward(session: Session, job_ids: Sequence[str], priority: Priority) -> None:
    while job_ids:
        behind = update(JobRow).where(JobRow.id.in_(job_ids), JobRow.priority > priority)
        session.execute(behind.values(priority=priority))
        needed = select(JobDependencyRow.needs_job_id).where(JobDependencyRow.job_id.in_(job_ids))
        job_ids = session.scalars(needed).all()
