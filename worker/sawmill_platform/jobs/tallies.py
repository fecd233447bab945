"""Numbers of jobs and of attempts for monitoring, and what the owner of the kinds of jobs gives to the job store.

Counts come from the rows, so that they are right with any number of workers and outlive every process. Attempts are
counted by their events, which are only added: an event that was counted is not read again.
"""

import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Select, case, func, select
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.jobs import JobKind, JobState
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import EventRow, JobRow, seconds_between
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.files.named_folders import NamedFolder
from sawmill_platform.ledger.events import PEAK_MEMORY

# Ends of classes of durations: from a short job on an empty queue to a job over night.
DURATIONS_S = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 10_000.0, 30_000.0)
# Transactions give up after seconds: every smaller event number than one of this age is written, or never will be.
SETTLED = timedelta(minutes=10)
_ALL = 2**62


class Fate(NamedTuple):
    """Outcome of some attempts: `fault` and `code` of a failure, and `duration`, a class of `DURATIONS_S`."""

    type: EventType
    kind: JobKind
    fault: str | None
    code: str | None
    duration: int


class Amount(NamedTuple):
    """Totals of one fate: attempts, their seconds, attempts with known memory, and its sum and maximum."""

    number: int
    seconds: float
    measured: int
    peak_bytes: float
    most_bytes: float

    def with_more(self, more: "Amount") -> "Amount":
        """Return the sum of both amounts."""
        return Amount(
            number=self.number + more.number,
            seconds=self.seconds + more.seconds,
            measured=self.measured + more.measured,
            peak_bytes=self.peak_bytes + more.peak_bytes,
            most_bytes=max(self.most_bytes, more.most_bytes),
        )


NONE = Amount(0, 0.0, 0, 0.0, 0.0)


@dataclass(frozen=True)
class Tally:
    """Counts at one time."""

    at: datetime  # time by the store's clock
    jobs: Mapping[tuple[JobKind, JobState], int]  # number of jobs, by kind and state
    # queued_s, running_s: seconds, by kind, since the oldest queued job was created, and since the earliest start of a
    # running job.
    queued_s: Mapping[JobKind, float]
    running_s: Mapping[JobKind, float]
    workers: int  # number of workers that have started or ended an attempt within `SETTLED`, or are running one
    fates: Mapping[Fate, Amount]  # outcomes of attempts so far


class Tallies:
    """Counts, which add new events to events that were counted before."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self.counted_to = 0
        self._settled: dict[Fate, Amount] = {}

    def read(self) -> Tally:
        """Count jobs and attempts."""
        now = self._database.now()
        with self._lock, self._database.read() as session:
            newer = select(EventRow.number).where(EventRow.number > self.counted_to, EventRow.at <= now - SETTLED)
            last = session.scalar(newer.order_by(EventRow.number.desc()).limit(1))
            if last is not None:
                these = _fates(session, EventRow.number > self.counted_to, EventRow.number <= last)
                self._settled, self.counted_to = _together(self._settled, these), last
            fates = _together(self._settled, _fates(session, EventRow.number > self.counted_to))
            jobs, queued_s = _jobs(session, now)
            running = session.execute(
                select(JobRow.kind, JobRow.started_at, JobRow.worker).where(JobRow.state == JobState.RUNNING)
            ).all()
            recent = session.scalars(select(EventRow.worker).where(EventRow.number > self.counted_to).distinct())
            workers = {*recent, *(worker for *_, worker in running)} - {None}
        running_s: dict[JobKind, float] = {}
        for kind, started_at, _ in running:
            running_s[kind] = max(running_s.get(kind, 0.0), _since(started_at, now))
        return Tally(at=now, jobs=jobs, queued_s=queued_s, running_s=running_s, workers=len(workers), fates=fates)


def _jobs(session: Session, now: datetime) -> tuple[Counter[tuple[JobKind, JobState]], dict[JobKind, float]]:
    """Count jobs in one pass through an index (`ix_jobs_places`) in the index's order."""
    columns = (JobRow.state, JobRow.priority, JobRow.short, JobRow.kind)
    counted = select(*columns, func.count(), func.min(JobRow.created_at)).group_by(*columns)
    jobs: Counter[tuple[JobKind, JobState]] = Counter()
    queued_s: dict[JobKind, float] = {}
    for state, _, _, kind, number, oldest in session.execute(counted):
        jobs[kind, state] += number
        if state is JobState.QUEUED:
            queued_s[kind] = max(queued_s.get(kind, 0.0), _since(oldest, now))
    return jobs, queued_s


def _fates(session: Session, *which: ColumnElement[bool]) -> dict[Fate, Amount]:
    ended = _ended(session.get_bind().dialect.name, *which).subquery()
    duration = case(
        *((ended.c.seconds <= end_s, number) for number, end_s in enumerate(DURATIONS_S)), else_=len(DURATIONS_S)
    )
    classed = select(*ended.c, duration.label("duration")).subquery()
    fate = (classed.c.type, classed.c.kind, classed.c.fault, classed.c.code, classed.c.duration)
    amount = (
        func.count(),
        func.coalesce(func.sum(classed.c.seconds), 0.0),
        func.count(classed.c.peak_bytes),
        func.coalesce(func.sum(classed.c.peak_bytes), 0.0),
        func.coalesce(func.max(classed.c.peak_bytes), 0.0),
    )
    rows = session.execute(select(*fate, *amount).group_by(*fate))
    return {Fate(*row[: len(fate)]): Amount(*row[len(fate) :]) for row in rows}


def _ended(dialect: str, *which: ColumnElement[bool]) -> Select[Any]:
    """Select a row for each attempt that a worker has ended; its seconds are known if the job ended with a result."""
    succeeded = EventRow.type == event_kinds.SUCCEEDED
    return (
        select(
            EventRow.type,
            JobRow.kind,
            EventRow.detail["kind"].as_string().label("fault"),
            EventRow.detail["code"].as_string().label("code"),
            EventRow.detail[PEAK_MEMORY].as_float().label("peak_bytes"),
            case((succeeded, seconds_between(dialect, JobRow.started_at, JobRow.finished_at))).label("seconds"),
        )
        .join(JobRow, JobRow.id == EventRow.job_id)
        .where(EventRow.type != event_kinds.STARTED, EventRow.worker.is_not(None), *which)
        .limit(_ALL)  # otherwise SQLite computes the seconds again for each class of durations
    )


def _since(then: datetime | None, now: datetime) -> float:
    return 0.0 if then is None else max((now - then).total_seconds(), 0.0)


def _together(some: Mapping[Fate, Amount], others: Mapping[Fate, Amount]) -> dict[Fate, Amount]:
    return {fate: some.get(fate, NONE).with_more(others.get(fate, NONE)) for fate in some.keys() | others.keys()}


class Recorded(NamedTuple):
    """A result for the ledger: a sentence for the history, and details for the event, which go to all followers."""

    why: str | None = None
    detail: Mapping[str, Any] = {}


class Subjects(NamedTuple):
    """Folders in which rows name files, and functions on the rows and files that jobs work on.

    Functions with a session are called within the job store's transaction. `handed_over` returns the input of an
    attempt, or raises `NotFound` if something was deleted since the request; `record_success` and
    `record_end_without_result` write a job's end to its subject, by its id; `output_file` returns the file that a job
    left, unopened, or raises `InvalidOutput`; `read_apart` reads a result of an earlier version, which has no digest,
    in a separate process, or raises `DamagedResult`.
    """

    named_folders: Sequence[NamedFolder]
    handed_over: Callable[[Session, FileStore, JobRow], AttemptInput]
    record_success: Callable[[Session, JobKind, str, Contract, datetime], Recorded]
    record_end_without_result: Callable[[Session, JobKind, str, str, datetime], None]
    output_file: Callable[[JobKind, Path], Path | None]
    read_apart: Callable[[Path], None]
