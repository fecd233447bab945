"""The audit: decisions of the ledger, which the database itself refuses to change or to remove."""

from collections.abc import Collection, Iterator, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import func, select, text

from sawmill_platform.contracts.audit import AuditEntry
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.paging import read_numbered_page
from sawmill_platform.database.tables import DECIDED, EventRow

_BATCH = 500
# Condition of the partial index, in its words.
_DECIDED = text(DECIDED)


def changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that differ, as [before, after] by name."""
    names = {**before, **after}
    return {name: [before.get(name), after.get(name)] for name in names if before.get(name) != after.get(name)}


class Audit(StorePart):
    """Entries of the audit; no method changes an entry."""

    def page(
        self,
        *,
        who: str | None = None,
        action: EventType | None = None,
        without: Collection[EventType] = (),
        since: datetime | None = None,
        until: datetime | None = None,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[AuditEntry]:
        """Return a page of entries, newest first.

        Parameters
        ----------
        who, action
            Name of the actor, and kind of the action; None: all.
        without
            Kinds of actions that are left out.
        since, until
            Times from which and before which the entries were made; None: no bound.
        after, limit
            Cursor of the previous page, and the number of entries.

        Raises
        ------
        Invalid
            `after` is not a cursor from an earlier page.
        """
        conditions = (
            None if who is None else EventRow.who == who,
            None if action is None else EventRow.type == action,
            EventRow.type.not_in(without),
            None if since is None else EventRow.at >= since,
            None if until is None else EventRow.at < until,
        )
        statement = select(EventRow).where(_DECIDED, *(each for each in conditions if each is not None))
        with self._database.read() as session:
            return read_numbered_page(session, statement, EventRow.number, read_audit_entry, after=after, limit=limit)

    def actors(self) -> list[str]:
        """Return the names of everybody with an entry, in alphabetical order."""
        names = select(EventRow.who).where(_DECIDED, EventRow.who.is_not(None)).distinct().order_by(EventRow.who)
        with self._database.read() as session:
            return list(session.scalars(names))

    def all(self) -> Iterator[AuditEntry]:
        """Yield every entry, the oldest first, with a transaction for each few hundred."""
        last = 0
        while entries := self._following(last):
            yield from entries
            last = entries[-1].number

    def extent(self) -> tuple[int, int]:
        """Return the number of entries and the newest entry's number: the same as long as no entry is added."""
        statement = select(func.count(), func.coalesce(func.max(EventRow.number), 0)).where(_DECIDED)
        with self._database.read() as session:
            count, newest = session.execute(statement).one()
        return count, newest

    def _following(self, number: int) -> list[AuditEntry]:
        statement = select(EventRow).where(_DECIDED, EventRow.number > number).order_by(EventRow.number).limit(_BATCH)
        with self._database.read() as session:
            return [read_audit_entry(row) for row in session.scalars(statement)]


def read_audit_entry(row: EventRow) -> AuditEntry:
    """Return the entry of a decision."""
    return AuditEntry.of_row(row, action=row.type, detail=row.decided)
