"""Turns in the queue, and estimates of the time that jobs may still take, by the median of the last jobs of a kind.

Turns in the queue: within a priority groups take turns, and within a group the oldest job goes first. A group's jobs
do not wait behind thousands of another group's jobs. Each claim notes that its group was served, apart for workers
that take short jobs only: a group whose short jobs are served all the time still has its turn with a long one.
"""

import time
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import chain, groupby, zip_longest
from operator import attrgetter, itemgetter
from statistics import median
from typing import NamedTuple

from sqlalchemy import Boolean, ColumnElement, Integer, String, and_, func, select, type_coerce
from sqlalchemy.dialects.postgresql import insert as insert_on_postgresql
from sqlalchemy.dialects.sqlite import insert as insert_on_sqlite
from sqlalchemy.orm import Session

from sawmill_platform.contracts.jobs import JobKind, JobState, Priority
from sawmill_platform.database.tables import JobRow, JobTurnRow

QUEUED = JobRow.state == JobState.QUEUED
# Order without turns: the highest priority first, then the oldest job.
FIRST_COME = (JobRow.priority, JobRow.created_at, JobRow.id)
_GROUP = (JobRow.priority, JobRow.group_id)


@dataclass(frozen=True)
class Selection:
    """Jobs that a worker takes; null takes any."""

    short: bool | None = None  # True: short jobs only; False: long jobs only
    # kinds, group_ids: jobs of these kinds, and of these groups.
    kinds: frozenset[JobKind] | None = None
    group_ids: frozenset[str] | None = None

    def conditions(self) -> list[ColumnElement[bool]]:
        """Return the conditions that rows of such jobs fulfil."""
        chosen = [] if self.short is None else [JobRow.short == self.short]
        sets = ((JobRow.kind, self.kinds), (JobRow.group_id, self.group_ids))
        return chosen + [column.in_(values) for column, values in sets if values is not None]


ANY = Selection()


class Turn(NamedTuple):
    """The jobs of one group at one priority."""

    priority: Priority
    group_id: str

    def conditions(self) -> list[ColumnElement[bool]]:
        """Return the conditions that rows of these jobs fulfil."""
        return [column == value for column, value in zip(_GROUP, self, strict=True)]


class Place(NamedTuple):
    """A queued job, with the fields that matter to jobs that wait for it."""

    job_id: str
    kind: str
    short: bool


def turns(session: Session, selection: Selection) -> list[Turn]:
    """List the groups with jobs that wait, by priority, then the group that was served longest ago first.

    On PostgreSQL two claims at the same moment may see the same turn; still no job is claimed twice.
    """
    waiting = select(*_GROUP, func.min(JobRow.created_at).label("oldest")).where(QUEUED, *selection.conditions())
    groups = waiting.group_by(*_GROUP).subquery()
    of_group = (JobTurnRow.priority == groups.c.priority, JobTurnRow.group_id == groups.c.group_id)
    served = groups.outerjoin(JobTurnRow, and_(JobTurnRow.short_only == (selection.short is True), *of_group))
    last_turn = func.coalesce(JobTurnRow.turn, 0)
    in_turn = select(groups.c.priority, groups.c.group_id).select_from(served)
    ordered = in_turn.order_by(groups.c.priority, last_turn, groups.c.oldest, groups.c.group_id)
    return [Turn(*row) for row in session.execute(ordered)]


def note_served(session: Session, selection: Selection, turn: Turn) -> None:
    """Put a group behind all other groups, in the transaction that claims its job."""
    insert = insert_on_sqlite if session.get_bind().dialect.name == "sqlite" else insert_on_postgresql
    following = select(func.coalesce(func.max(JobTurnRow.turn), 0) + 1).scalar_subquery()
    served = insert(JobTurnRow).values(**turn._asdict(), short_only=selection.short is True, turn=following)
    key = ["short_only", *turn._fields]
    session.execute(served.on_conflict_do_update(index_elements=key, set_={"turn": served.excluded.turn}))


def places(session: Session, selection: Selection = ANY) -> list[Place]:
    """List the queued jobs in the order in which they will be claimed, if no job is added and each can start."""
    # Plain values: making enums of thousands of rows takes time.
    plain = (JobRow.id, type_coerce(JobRow.kind, String), type_coerce(JobRow.short, Boolean), JobRow.group_id)
    queued = select(*plain, type_coerce(JobRow.priority, Integer)).where(QUEUED, *selection.conditions())
    in_groups = session.connection().execute(queued.order_by(*_GROUP, JobRow.created_at, JobRow.id))
    groups = {key: [Place(*row[:3]) for row in rows] for key, rows in groupby(in_groups, key=itemgetter(4, 3))}
    by_priority = groupby(turns(session, selection), key=attrgetter("priority"))
    # In a transaction that writes, PostgreSQL shows the second statement jobs that were added after the first one.
    rounds = (
        zip_longest(*(groups.get((turn.priority.rank, turn.group_id), ()) for turn in of_one))
        for _, of_one in by_priority
    )
    return [place for each in chain.from_iterable(rounds) for place in each if place is not None]


_RECENT = 1000  # ended jobs that are searched for jobs of a kind
_ENOUGH = 20  # jobs of a kind: more of them change the median little
_REFRESH_S = 5.0
# Share of a job that must be done before its own pace predicts more than other jobs of the kind.
_TELLING = 0.1


class Line(NamedTuple):
    """Jobs that take about the same time: of one kind, in one lane."""

    kind: JobKind
    short: bool


class WaitEstimate(NamedTuple):
    """Number of jobs before one in the queue, and seconds until it succeeds; null where there is none, or unknown."""

    queue_position: int | None
    seconds_left: float | None


Durations = Mapping[Line, float]
NOTHING_KNOWN = WaitEstimate(None, None)


class WaitEstimates:
    """Estimates for jobs in a transaction that reads, in at most six statements for any number of jobs."""

    def __init__(self) -> None:
        self._durations: Durations = {}
        self._read_at_s: float | None = None

    def of(self, session: Session, rows: Sequence[JobRow], now: datetime) -> dict[str, WaitEstimate]:
        """Return estimates by the jobs' ids; ended jobs are left out."""
        running = [row for row in rows if row.state is JobState.RUNNING]
        queued = {row.id: row for row in rows if row.state is JobState.QUEUED}
        if not running and not queued:
            return {}
        durations = self._typical(session)
        estimates = {row.id: WaitEstimate(None, _rounded(_remaining_s(row, durations, now))) for row in running}
        if queued:
            at_work = _at_work(session)
            for job_id, before in _before(session, queued.values()).items():
                row = queued[job_id]
                wait_s = _wait_s(row, before, at_work, durations, now)
                estimates[job_id] = WaitEstimate(before.total(), _rounded(_sum([wait_s, durations.get(_line(row))])))
        return estimates

    def wait_s(self, session: Session, row: JobRow, now: datetime) -> float | None:
        """Estimate the seconds until a queued job may start; null: nothing runs, or too little is known."""
        at_work = _at_work(session)
        if not at_work:
            return None
        return _wait_s(row, _before(session, [row]).get(row.id, Counter()), at_work, self._typical(session), now)

    def _typical(self, session: Session) -> Durations:
        """Read the seconds from start to success: medians of the last jobs, at most a few seconds old."""
        if self._read_at_s is None or time.monotonic() - self._read_at_s > _REFRESH_S:
            self._durations, self._read_at_s = _durations(session), time.monotonic()
        return self._durations


def _durations(session: Session) -> Durations:
    columns = (JobRow.kind, JobRow.short, JobRow.started_at, JobRow.finished_at)
    succeeded = select(*columns).where(JobRow.state == JobState.SUCCEEDED)
    newest = succeeded.order_by(JobRow.created_at.desc(), JobRow.id.desc()).limit(_RECENT)
    taken_s: defaultdict[Line, list[float]] = defaultdict(list)
    for kind, short, started_at, finished_at in session.execute(newest):
        if started_at is not None and finished_at is not None:
            taken_s[Line(kind, short)].append((finished_at - started_at).total_seconds())
    return {line: median(all_s[:_ENOUGH]) for line, all_s in taken_s.items()}


def _at_work(session: Session) -> Sequence[JobRow]:
    return session.scalars(select(JobRow).where(JobRow.state == JobState.RUNNING)).all()


def _before(session: Session, rows: Collection[JobRow]) -> dict[str, Counter[Line]]:
    """Count the jobs that each queued job waits for: long jobs for all before them, short ones for short ones."""
    before: dict[str, Counter[Line]] = {}
    for selection, short in ((Selection(short=True), True), (ANY, False)):
        job_ids = {row.id for row in rows if row.short is short}
        counts: Counter[Line] = Counter()
        for place in places(session, selection) if job_ids else ():
            if place.job_id in job_ids:
                before[place.job_id] = counts.copy()
            counts[Line(JobKind.of(place.kind), place.short)] += 1
    return before


def _line(row: JobRow) -> Line:
    return Line(row.kind, row.short)


def _wait_s(
    row: JobRow, before: Counter[Line], at_work: Iterable[JobRow], durations: Durations, now: datetime
) -> float | None:
    """Estimate when a queued job may start: after the jobs before it, shared by the workers that run its lane now."""
    running = [
        job
        for job in at_work
        if (job.short or not row.short)
        and (job.priority is not Priority.BACKGROUND or row.priority is Priority.BACKGROUND)
    ]
    queued_s = _sum(number * durations[line] if line in durations else None for line, number in before.items())
    work_s = _sum([queued_s, *(_remaining_s(job, durations, now) for job in running)])
    workers = max(1, sum(job.short == row.short for job in running))
    return None if work_s is None else max(work_s / workers, (row.not_before_s or 0.0) - now.timestamp())


def _remaining_s(row: JobRow, durations: Durations, now: datetime) -> float | None:
    """Estimate by the job's own report, otherwise by its pace, otherwise by the durations of other jobs."""
    progress = row.progress or {}
    if progress.get("seconds_left") is not None:
        return float(progress["seconds_left"])
    elapsed_s = max(0.0, (now - (row.started_at or now)).total_seconds())
    done = float(progress.get("fraction", 0.0))
    if done >= _TELLING:
        return elapsed_s * (1.0 - done) / done
    typical_s = durations.get(_line(row))
    return None if typical_s is None else max(0.0, typical_s - elapsed_s)


def _sum(parts: Iterable[float | None]) -> float | None:
    """Add up the parts; null if a part is unknown."""
    known = list(parts)
    return None if None in known else sum(part for part in known if part is not None)


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 1)
