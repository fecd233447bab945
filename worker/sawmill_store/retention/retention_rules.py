"""Kinds that have rules of retention: the rows of each kind, and the reach of the rules."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import BigInteger, ColumnElement, Select, and_, cast, exists, false, func, or_, select
from sqlalchemy.orm import Session

from sawmill_contracts import job_kinds
from sawmill_contracts.retention import RetentionKind, RetentionRules, rule_name
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_store.tables import AskedRow, CalibrationRow, DriftRow, ReconstructionRow, ScanRow


@dataclass(frozen=True)
class Stock:
    """The rows of one kind.

    Attributes
    ----------
    kind : RetentionKind
        Kind of the rows.
    job : JobKind
        Kind of the jobs that made the rows.
    table : type
        Table of the rows.
    which : tuple
        Conditions that select the rows of this kind in the table.
    """

    kind: RetentionKind
    job: JobKind
    table: type[Any]
    which: tuple[ColumnElement[bool], ...] = ()

    @property
    def has_bytes(self) -> bool:
        """True if the files of the kind have sizes that count."""
        return hasattr(self.table, "stored_bytes")

    @property
    def all_bytes(self) -> ColumnElement[int]:
        """Sum of the stored bytes of several rows; rows that are not measured count as zero."""
        return cast(func.coalesce(func.sum(self.table.stored_bytes), 0), BigInteger)

    def select(self, *columns: Any, until: ColumnElement[bool]) -> Select[Any]:  # noqa: ANN401 - any columns
        """Select columns of the rows of this kind for which `until` is true."""
        return select(*columns).select_from(self.table).where(*self.which, until)


# Rows are read in parts: a year of logs is never in memory.
_SOME = {"yield_per": 1000}
_INSPECTED = exists().where(JobRow.id == AskedRow.job_id, JobRow.kind == job_kinds.INSPECT)
_LOG, _OF_PHANTOM = ScanRow.phantom_id.is_(None), ScanRow.phantom_id.is_not(None)
STOCKS: Mapping[RetentionKind, Stock] = {
    stock.kind: stock
    for stock in (
        Stock(RetentionKind.LOG_SCANS, job_kinds.INGEST, ScanRow, (_LOG,)),
        Stock(RetentionKind.PHANTOM_SCANS, job_kinds.INGEST, ScanRow, (_OF_PHANTOM,)),
        Stock(RetentionKind.RECONSTRUCTIONS, job_kinds.RECONSTRUCT, ReconstructionRow),
        Stock(RetentionKind.CALIBRATIONS, job_kinds.CALIBRATE, CalibrationRow),
        Stock(RetentionKind.DRIFTS, job_kinds.DRIFT, DriftRow),
        Stock(RetentionKind.INSPECTIONS, job_kinds.INSPECT, AskedRow, (_INSPECTED,)),
    )
}
"""All kinds but events, which have numbers and no jobs of their own."""


class Reach(NamedTuple):
    """Reach of the rules, from the oldest row on.

    Attributes
    ----------
    aged : datetime or None
        Rows created until this time are too old.
    full : tuple or None
        Time and id of the newest row that exceeds the allowed bytes.
    """

    aged: datetime | None
    full: tuple[datetime, str] | None

    def beyond(self, stock: Stock) -> ColumnElement[bool]:
        """Return the condition that the rules reach a row: one span of the index by age."""
        table = stock.table
        if self.full is None or (self.aged is not None and self.full[0] <= self.aged):
            return false() if self.aged is None else table.created_at <= self.aged
        at, identifier = self.full
        return and_(table.created_at <= at, or_(table.created_at < at, table.id <= identifier))

    def rule_of(self, kind: RetentionKind, created_at: datetime) -> str:
        """Return the name of the rule that reaches a row created at this time."""
        return rule_name(kind, "days" if self.aged is not None and created_at <= self.aged else "bytes")


def reach_of(session: Session, stock: Stock, rules: RetentionRules, at: datetime) -> Reach:
    """Compute the reach of the rules at a time; rows created later are not counted."""
    days, most = rules.days_of(stock.kind), rules.bytes_of(stock.kind)
    aged = None if days is None else at - timedelta(days=days)
    return Reach(aged, None if most is None else _without_room(session, stock, most, at))


def _without_room(session: Session, stock: Stock, most: int, at: datetime) -> tuple[datetime, str] | None:
    """Find the newest row that must go so that the rows after it have at most `most` bytes."""
    table = stock.table
    until = table.created_at <= at
    over = (session.scalar(stock.select(stock.all_bytes, until=until)) or 0) - most
    if over <= 0:
        return None
    oldest_first = (table.created_at, table.id)
    sizes = session.scalars(
        stock.select(table.stored_bytes, until=until).order_by(*oldest_first), execution_options=_SOME
    )
    for place, stored_bytes in enumerate(sizes):
        over -= stored_bytes or 0
        if over <= 0:
            sizes.close()
            last = stock.select(*oldest_first, until=until).order_by(*oldest_first).offset(place).limit(1)
            created_at, identifier = session.execute(last).one()
            return created_at, identifier
    return None  # rows were removed between the two statements


def last_old_event(session: Session, rules: RetentionRules, at: datetime) -> int:
    """Find the number of the newest event that is too old; 0: none.

    The newest event of all is never too old: numbers continue from it. Numbers grow with time, so that the event is
    found by bisection: there is no index by time.
    """
    ends = (select(least(EventRow.number)).scalar_subquery() for least in (func.min, func.max))
    first, newest = session.execute(select(*ends)).one()
    if rules.events_days is None or first is None:
        return 0
    aged = at - timedelta(days=rules.events_days)
    low, high = first - 1, newest - 1
    while low < high:
        middle = (low + high) // 2
        following = select(EventRow.number, EventRow.at).where(EventRow.number > middle).order_by(EventRow.number)
        number, happened_at = session.execute(following.limit(1)).one()
        if happened_at <= aged:
            low = number
        else:
            high = middle
    return low if low >= first else 0
