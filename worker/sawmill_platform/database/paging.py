"""Lists, newest first, one page at a time."""

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar
from uuid import uuid4

from sqlalchemy import Select, and_, or_, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from sawmill_platform.contracts.base import Contract, Page
from sawmill_platform.contracts.patterns import CURSOR
from sawmill_platform.database.tables import Resource
from sawmill_platform.errors import Conflict, Invalid, NotFound

Row = TypeVar("Row", bound=Resource)
Item = TypeVar("Item", bound=Contract)
Check = Callable[[Item], None]  # raises an exception for a stored resource that is not to be replaced

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
# PostgreSQL's integer.
LARGEST_NUMBER = 2**31 - 1


def new_id() -> str:
    """Return an identifier that nobody can guess."""
    return uuid4().hex


def found(session: Session, table: type[Row], kind: str, identifier: str, *, lock: bool = False) -> Row:
    """Return the row with this id.

    Raises
    ------
    NotFound
        There is no such row.
    """
    row = session.get(table, identifier, with_for_update=lock or None)
    if row is None:
        raise NotFound(kind, identifier)
    return row


def accept_any(resource: Contract) -> None:
    """Accept that a resource is replaced whatever it is."""


def hold(session: Session, table: type[Row], kind: str, identifier: str) -> None:
    """Keep a row from being deleted until the transaction ends, for rows that will refer to it.

    Several transactions may hold the same row.

    Raises
    ------
    NotFound
        There is no such row, or no longer.
    """
    there = select(table.id).where(table.id == identifier).with_for_update(read=True, key_share=True)
    if session.scalar(there) is None:
        raise NotFound(kind, identifier)


def refuse_taken(session: Session, table: type[Resource], kind: str, identifier: str) -> None:
    """Refuse an id that is in use already.

    Raises
    ------
    Conflict
        The id is in use; the code is `<kind>-exists`.
    """
    if session.get(table, identifier) is not None:
        raise Conflict(f"{kind}-exists", f"there is a {kind} {identifier!r} already; choose another id")


def narrowed(statement: Select[Row], wanted: Mapping[InstrumentedAttribute[Any], str | None]) -> Select[Row]:
    """Select the rows whose columns have these values; None matches any value."""
    return statement.where(*(column == value for column, value in wanted.items() if value is not None))


def created_between(
    statement: Select[Row], table: type[Row], first: datetime | None, end: datetime | None
) -> Select[Row]:
    """Select the rows made from `first` on and before `end`; None sets no bound."""
    bounds = (None if first is None else table.created_at >= first, None if end is None else table.created_at < end)
    return statement.where(*(bound for bound in bounds if bound is not None))


def read_page(
    session: Session,
    statement: Select[Row],
    table: type[Row],
    read: Callable[[Row], Item],
    *,
    after: str | None,
    limit: int,
) -> Page[Item]:
    """Run a filtered statement as one page, newest first.

    Raises
    ------
    Invalid
        `after` is not a cursor from an earlier page.
    """
    rows, following = rows_of_page(session, statement, table, after=after, limit=limit)
    return Page[Any](items=[read(row) for row in rows], next=following)


def rows_of_page(
    session: Session, statement: Select[Row], table: type[Row], *, after: str | None, limit: int
) -> tuple[Sequence[Row], str | None]:
    """Return the rows of a page, and the cursor of the next page or None; parameters as in `read_page`."""
    if after is not None:
        moment, identifier = parse_cursor(after)
        older = or_(table.created_at < moment, and_(table.created_at == moment, table.id < identifier))
        statement = statement.where(older)
    order = (table.created_at.desc(), table.id.desc())
    # The ids of the page first: if no index has this order, the whole table is sorted, without the rows' content.
    ids = statement.with_only_columns(table.id, maintain_column_froms=True).order_by(*order).limit(limit + 1).subquery()
    rows: Sequence[Row] = session.scalars(select(table).join(ids, ids.c.id == table.id).order_by(*order)).all()
    shown = rows[:limit]
    return shown, cursor_of(shown[-1].created_at, shown[-1].id) if len(rows) > limit else None


def read_numbered_page(
    session: Session,
    statement: Select[Any],
    number: InstrumentedAttribute[int],
    read: Callable[[Any], Item],
    *,
    after: str | None,
    limit: int,
) -> Page[Item]:
    """Run a statement as `read_page` does, for numbered rows: the cursor is the last number of the page before.

    Raises
    ------
    Invalid
        `after` is not a cursor from an earlier page.
    """
    if after is not None:
        if re.fullmatch(r"[0-9]{1,18}", after) is None or int(after) > LARGEST_NUMBER:
            raise Invalid("invalid-cursor", f"after must be the next of an earlier page, not {after!r}")
        statement = statement.where(number < int(after))
    rows = session.scalars(statement.order_by(number.desc()).limit(limit + 1)).all()
    shown = rows[:limit]
    following = str(getattr(shown[-1], number.key)) if len(rows) > limit else None
    return Page[Any](items=[read(row) for row in shown], next=following)


def cursor_of(moment: datetime, identifier: str) -> str:
    """Return the cursor of a page whose last row has this time, and this id among rows of the same time."""
    return f"{(moment - _EPOCH) // _MICROSECOND}.{identifier}"


def parse_cursor(cursor: str) -> tuple[datetime, str]:
    """Return the time and the id of a cursor from `cursor_of`.

    Raises
    ------
    Invalid
        The text is not a cursor from an earlier page.
    """
    if re.fullmatch(CURSOR, cursor) is None:
        raise Invalid("invalid-cursor", f"after must be the next of an earlier page, not {cursor!r}")
    microseconds, _, identifier = cursor.partition(".")
    return _EPOCH + int(microseconds) * _MICROSECOND, identifier
