"""The audit: decisions of the ledger, which the database itself refuses to change or to remove."""

from collections.abc import Iterator, Mapping
from typing import Any

from sqlalchemy import Select, func, select, text

from sawmill_platform.contracts.audit import AuditEntry
from sawmill_platform.contracts.base import Page
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import read_numbered_page
from sawmill_platform.database.tables import DECIDED, EventRow

_BATCH = 500
# As the partial index has it.
_DECIDED = text(DECIDED)


def changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """What differs, as [before, after] by name."""
    names = {**before, **after}
    return {name: [before.get(name), after.get(name)] for name in names if before.get(name) != after.get(name)}


class Audit:
    """The entries; nothing here changes one."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def page(self, *, after: str | None = None, limit: int = 50) -> Page[AuditEntry]:
        """Newest first.

        Raises
        ------
        Invalid
            `after` is not a cursor that an earlier page gave.
        """
        with self._database.read() as session:
            return read_numbered_page(
                session, _decisions(), EventRow.number, read_audit_entry, after=after, limit=limit
            )

    def all(self) -> Iterator[AuditEntry]:
        """Every entry, the oldest first; a transaction for each few hundred."""
        last = 0
        while entries := self._following(last):
            yield from entries
            last = entries[-1].number

    def extent(self) -> tuple[int, int]:
        """How many entries there are, and the newest one's number: the same as long as none is added."""
        statement = select(func.count(), func.coalesce(func.max(EventRow.number), 0)).where(_DECIDED)
        with self._database.read() as session:
            count, newest = session.execute(statement).one()
        return count, newest

    def _following(self, number: int) -> list[AuditEntry]:
        statement = _decisions().where(EventRow.number > number).order_by(EventRow.number).limit(_BATCH)
        with self._database.read() as session:
            return [read_audit_entry(row) for row in session.scalars(statement)]


def _decisions() -> Select[EventRow]:
    return select(EventRow).where(_DECIDED)


def read_audit_entry(row: EventRow) -> AuditEntry:
    """Return the entry of a decision."""
    names = AuditEntry.model_fields.keys() - {"action", "detail"}
    fields = {name: getattr(row, name) for name in names} | {"action": row.what, "detail": row.decided}
    return AuditEntry.model_validate(fields)
