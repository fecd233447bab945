"""Stocks of stored rows: what the rows of a kind are, what keeps them, and the reach of rules of retention."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal, NamedTuple

from sqlalchemy import BigInteger, ColumnElement, Select, and_, cast, false, func, or_, select, true
from sqlalchemy.orm import InstrumentedAttribute, Session

from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.retention import Limits
from sawmill_platform.database.tables import EventRow


class Protection(NamedTuple):
    """A reason, and the condition that is true for the rows that stay for this reason; it is never unknown (NULL)."""

    because: str
    condition: ColumnElement[bool]


KeptBy = Callable[[Session], Iterable[Protection]]
"""Function that returns what keeps rows of a kind, as of a transaction."""


def none_of(kept: Iterable[Protection]) -> ColumnElement[bool]:
    """Return the condition that nothing keeps a row."""
    return and_(true(), *(~each.condition for each in kept))


@dataclass(frozen=True)
class Stock:
    """The rows of one kind.

    Attributes
    ----------
    kind : str
        Kind of the rows, as rules name it.
    job : JobKind
        Kind of the jobs that made the rows.
    table : type
        Table of the rows, with `id`, `created_at` and `job_id`, and with `stored_bytes` where files have sizes that
        count.
    owner : tuple of two columns
        Column with the id of the row to which a row belongs, and the id of such rows; these are locked first.
    kept_by : callable
        Returns what keeps rows of this kind.
    which : tuple
        Conditions that select the rows of this kind in the table.
    jobs_stay : bool
        True if the jobs of removed rows are kept.
    forget : callable or None
        Function that removes other rows' references to the rows with some ids. None: there are none.
    """

    kind: str
    job: JobKind
    table: type[Any]
    owner: tuple[InstrumentedAttribute[Any], InstrumentedAttribute[str]]
    kept_by: KeptBy
    which: tuple[ColumnElement[bool], ...] = ()
    jobs_stay: bool = False
    forget: Callable[[Session, Sequence[str]], None] | None = None

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


# Rows are read in parts: a year of rows is never in memory.
_SOME = {"yield_per": 1000}


class Reach(NamedTuple):
    """Reach of the rules, from the oldest row of a stock on.

    Attributes
    ----------
    stock : Stock
        The stock.
    aged : datetime or None
        Rows created until this time are too old.
    full : tuple or None
        Time and id of the newest row that exceeds the allowed bytes.
    """

    stock: Stock
    aged: datetime | None
    full: tuple[datetime, str] | None

    def beyond(self) -> ColumnElement[bool]:
        """Return the condition that the rules reach a row: one span of the index by age."""
        table = self.stock.table
        if self.full is None or (self.aged is not None and self.full[0] <= self.aged):
            return false() if self.aged is None else table.created_at <= self.aged
        at, identifier = self.full
        return and_(table.created_at <= at, or_(table.created_at < at, table.id <= identifier))

    def unit_for(self, created_at: datetime) -> Literal["days", "bytes"]:
        """Return the unit of the rule that reaches a row created at this time."""
        return "days" if self.aged is not None and created_at <= self.aged else "bytes"


def reach_of(session: Session, stock: Stock, limits: Limits, at: datetime) -> Reach:
    """Compute the reach of the limits at a time; rows created later are not counted."""
    days, most = limits
    aged = None if days is None else at - timedelta(days=days)
    return Reach(stock, aged, None if most is None else _without_room(session, stock, most, at))


def _without_room(session: Session, stock: Stock, most: int, at: datetime) -> tuple[datetime, str] | None:
    """Find the newest row that must go so that the rows after it have at most `most` bytes."""
    table = stock.table
    until = table.created_at <= at
    over = (session.scalar(stock.select(stock.all_bytes, until=until)) or 0) - most
    if over <= 0:
        return None
    oldest_first = (table.created_at, table.id)
    rows = session.execute(
        stock.select(table.stored_bytes, *oldest_first, until=until).order_by(*oldest_first), execution_options=_SOME
    )
    for stored_bytes, created_at, identifier in rows:
        over -= stored_bytes or 0
        if over <= 0:
            rows.close()
            return created_at, identifier
    return None  # in a transaction that writes: rows were removed since the sum


def last_old_event(session: Session, days: int | None, at: datetime) -> int:
    """Find the number of the newest event that is older than this number of days; 0: none.

    The newest event of all is never too old: numbers continue from it. Numbers grow with time, so that the event is
    found by bisection: there is no index by time.
    """
    ends = (select(least(EventRow.number)).scalar_subquery() for least in (func.min, func.max))
    first, newest = session.execute(select(*ends)).one()
    if days is None or first is None:
        return 0
    aged = at - timedelta(days=days)
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
