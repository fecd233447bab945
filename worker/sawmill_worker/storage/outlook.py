"""What lies before queued jobs, and how long jobs may still take, by how long others of their kind took lately."""

import time
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby
from operator import itemgetter
from statistics import median
from typing import Any, NamedTuple

from sqlalchemy import Over, and_, func, literal, select, true, tuple_, union_all
from sqlalchemy.orm import Session

from sawmill_worker.contracts.jobs import JobKind, JobState, Priority
from sawmill_worker.storage.tables import JobRow, UtcDateTime

ORDER = (JobRow.priority, JobRow.created_at, JobRow.id)
_RECENT = 1000  # ended jobs among which those of a kind are looked for
_ENOUGH = 20  # of a kind: its median changes little by more
_REFRESH_S = 5.0
# Share of a job that must be done before its pace says more than other jobs of its kind.
_TELLING = 0.1


class Line(NamedTuple):
    """Jobs that take about as long as one another: of one kind, in one lane."""

    kind: JobKind
    short: bool


class Outlook(NamedTuple):
    """Jobs before one in the queue, and seconds until it succeeds; null where there is none, or nothing is known."""

    queue_position: int | None
    seconds_left: float | None


class _Running(NamedTuple):
    line: Line
    background: bool
    seconds_left: float | None


_LINES = [Line(kind, short) for kind in JobKind for short in (False, True)]
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Durations = Mapping[Line, float]
NOTHING_KNOWN = Outlook(None, None)


class Outlooks:
    """Of jobs in a transaction that reads: at most five statements, however many they are."""

    def __init__(self) -> None:
        self._durations: Durations = {}
        self._read_at_s: float | None = None

    def of(self, session: Session, rows: Sequence[JobRow], now: datetime) -> dict[str, Outlook]:
        """By the jobs' ids; those that have ended are left out."""
        unfinished = [row for row in rows if not row.state.ended]
        if not unfinished:
            return {}
        durations = self._typical(session)
        outlooks = {
            row.id: Outlook(None, _rounded(_remaining_s(row, durations, now)))
            for row in unfinished
            if row.state is JobState.RUNNING
        }
        queued = {row.id: row for row in unfinished if row.state is JobState.QUEUED}
        if queued:
            running = list(_running(session, durations, now))
            for job_id, before in _before(session, list(queued.values())):
                outlooks[job_id] = _of_queued(queued[job_id], before, running, durations, now)
        return outlooks

    def wait_s(self, session: Session, row: JobRow, now: datetime) -> float | None:
        """Seconds until a queued job may start; null: nothing runs, or too little is known."""
        if session.scalar(select(JobRow.id).where(JobRow.state == JobState.RUNNING).limit(1)) is None:
            return None
        durations = self._typical(session)
        [(_, before)] = _before(session, [row])
        return _wait_s(row, before, list(_running(session, durations, now)), durations, now)

    def _typical(self, session: Session) -> Durations:
        """Seconds from start to success: medians of the last jobs, of a few seconds ago at most."""
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


def _running(session: Session, durations: Durations, now: datetime) -> Iterator[_Running]:
    for row in session.scalars(select(JobRow).where(JobRow.state == JobState.RUNNING)):
        background = row.priority is Priority.BACKGROUND
        yield _Running(Line(row.kind, row.short), background, _remaining_s(row, durations, now))


def _before(session: Session, rows: Sequence[JobRow]) -> Iterator[tuple[str, Counter[Line]]]:
    """What is queued before each of some queued jobs."""
    first = _first(session, {row.priority for row in rows})
    for job_id, priority, counts in _steps(session, [row.id for row in rows]):
        first[priority].update(counts)
        yield job_id, Counter(first[priority])


def _first(session: Session, priorities: Collection[Priority]) -> dict[Priority, Counter[Line]]:
    """What is queued before the first job of a priority."""
    before = {priority: Counter[Line]() for priority in priorities}
    lower = JobRow.priority < max(priorities, key=lambda priority: priority.rank)
    columns = (JobRow.priority, JobRow.short, JobRow.kind)
    waiting = select(*columns, func.count()).where(JobRow.state == JobState.QUEUED, lower).group_by(*columns)
    for ahead, short, kind, number in session.execute(waiting):
        for priority, counts in before.items():
            if ahead.rank < priority.rank:
                counts[Line(kind, short)] += number
    return before


def _steps(session: Session, job_ids: Sequence[str]) -> Iterator[tuple[str, Priority, dict[Line, int]]]:
    """From one of these jobs to the next of its priority: what is queued between, counted in the index alone."""
    asked = select(
        *ORDER,
        _previous(JobRow.created_at, literal(_EPOCH, UtcDateTime())).label("from_created_at"),
        _previous(JobRow.id, literal("")).label("from_id"),
    )
    to = asked.where(JobRow.id.in_(job_ids)).cte("asked")
    line = union_all(
        *(
            select(literal(short).label("short"), literal(kind, JobRow.kind.type).label("kind"))
            for kind, short in _LINES
        )
    )
    lines = line.cte("lines")
    of_line = and_(JobRow.short == lines.c.short, JobRow.kind == lines.c.kind, JobRow.priority == to.c.priority)
    since = tuple_(JobRow.created_at, JobRow.id) >= tuple_(to.c.from_created_at, to.c.from_id)
    until = tuple_(JobRow.created_at, JobRow.id) < tuple_(to.c.created_at, to.c.id)
    number = select(func.count()).where(JobRow.state == JobState.QUEUED, of_line, since, until).scalar_subquery()
    counted = select(to.c.id, to.c.priority, lines.c.short, lines.c.kind, number).join_from(to, lines, true())
    steps = session.execute(counted.order_by(to.c.priority, to.c.created_at, to.c.id))
    for (job_id, priority), counts in groupby(steps, itemgetter(0, 1)):
        yield job_id, priority, {Line(kind, short): number for *_, short, kind, number in counts if number}


def _previous(column: Any, at_the_first: Any) -> Over[Any]:  # noqa: ANN401 - of any type
    """A column's value at the job asked for before, of the same priority."""
    return func.lag(column, 1, at_the_first).over(partition_by=JobRow.priority, order_by=ORDER[1:])


def _of_queued(
    row: JobRow, before: Counter[Line], running: Iterable[_Running], durations: Durations, now: datetime
) -> Outlook:
    wait_s = _wait_s(row, before, running, durations, now)
    typical_s = durations.get(Line(row.kind, row.short))
    return Outlook(_of_its_lane(row, before).total(), _rounded(_sum([wait_s, typical_s])))


def _of_its_lane(row: JobRow, before: Counter[Line]) -> Counter[Line]:
    """Long jobs wait for all that come before them, short ones for short ones."""
    return Counter({line: number for line, number in before.items() if line.short or not row.short})


def _wait_s(
    row: JobRow, before: Counter[Line], running: Iterable[_Running], durations: Durations, now: datetime
) -> float | None:
    """Until it may start."""
    own = _of_its_lane(row, before)
    goes_on = [
        job
        for job in running
        if (job.line.short or not row.short) and (not job.background or row.priority is Priority.BACKGROUND)
    ]
    queued_s = _sum(number * durations[line] if line in durations else None for line, number in own.items())
    work_s = _sum([queued_s, *(job.seconds_left for job in goes_on)])
    # As many at once as there are now.
    lanes = max(1, sum(job.line.short == row.short for job in goes_on))
    return None if work_s is None else max(work_s / lanes, (row.not_before_s or 0.0) - now.timestamp())


def _remaining_s(row: JobRow, durations: Durations, now: datetime) -> float | None:
    """By what it says itself, else by its pace, else by how long others took."""
    progress = row.progress or {}
    if progress.get("seconds_left") is not None:
        return float(progress["seconds_left"])
    elapsed_s = max(0.0, (now - (row.started_at or now)).total_seconds())
    done = float(progress.get("fraction", 0.0))
    if done >= _TELLING:
        return elapsed_s * (1.0 - done) / done
    typical_s = durations.get(Line(row.kind, row.short))
    return None if typical_s is None else max(0.0, typical_s - elapsed_s)


def _sum(parts: Iterable[float | None]) -> float | None:
    """Null where a part is unknown."""
    total = 0.0
    for part in parts:
        if part is None:
            return None
        total += part
    return total


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 1)
