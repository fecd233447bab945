"""Turns in the queue: within a priority groups take turns, and within a group the oldest job goes first.

A group's jobs do not wait behind thousands of another group's jobs. Each claim notes that its group was served, apart
for workers that take short jobs only: a group whose short jobs are served all the time still has its turn with a long
one.
"""

from dataclasses import dataclass
from itertools import chain, groupby, zip_longest
from operator import attrgetter, itemgetter
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
    """Jobs that a worker takes; null takes any.

    Attributes
    ----------
    short : bool or None
        True: short jobs only; False: long jobs only.
    kinds, group_ids : frozenset or None
        Jobs of these kinds, and of these groups.
    """

    short: bool | None = None
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
