"""Events in the order of their numbers, including events that are committed late.

SQLite has one writer at a time: numbers are committed in their order. On PostgreSQL each transaction takes its numbers
when it writes, and a later number may be committed first. A missing number belongs to a transaction that is still open,
or that was rolled back; the reader waits at the gap until every transaction that was open when the gap was found has
ended.
"""

import time
from datetime import timedelta
from itertools import pairwise, takewhile

from sqlalchemy import ColumnElement, func, select, text
from sqlalchemy.orm import Session

from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.events import Event
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import EventRow

_BATCH = 500
# A number is taken just before the server lists the transaction's id as open.
_SHORTEST_WAIT_S = 0.5
# The server ends transactions that are idle for 60 s (`sawmill_platform/database/postgresql.py`).
_LONGEST_TRANSACTION = timedelta(seconds=90)
# Id of the oldest open transaction, and of the next new one: equal if none is open.
_OPEN = text("SELECT txid_snapshot_xmin(now), txid_snapshot_xmax(now) FROM txid_current_snapshot() AS now")
_NEWEST = text(
    "SELECT (SELECT max(number) FROM events), txid_snapshot_xmin(now), txid_snapshot_xmax(now)"
    " FROM txid_current_snapshot() AS now"
)
_LOOKED_THROUGH = 5000  # rows of a minute and a half on a busy service


class EventReader:
    """Reader that continues from its last event; not for several threads at once."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._missed: int | None = None  # the number before the gap at which the reader waits
        self._missed_at_s = 0.0
        self._settled_by = 0  # the first transaction that had not started when the gap was found
        with database.read() as session:
            self._sequential = session.get_bind().dialect.name == "sqlite"
            self.number = self._newest(session)  # through which all events are written: none will come before it

    def read(self) -> list[Event]:
        """Return the next events, the oldest first; a few hundred at most.

        Raises
        ------
        StorageUnavailable
            The database does not answer; the next call continues.
        """
        missed: int | None = None
        there: list[Event] = []
        with self._database.read() as session:
            # The rows of all transactions that have ended by now are in this snapshot.
            open_since, _ = (0, 0) if self._sequential else _transactions(session)
            following = select(EventRow).where(EventRow.number > self.number).order_by(EventRow.number).limit(_BATCH)
            before = self.number
            for row in session.scalars(following).all():
                if row.number > before + 1 and not self._is_settled(before, open_since):
                    missed = before
                    break
                if row.type.is_public:
                    there.append(Event.of_row(row))
                before = row.number
        if missed is not None and missed != self._missed:  # a new gap, at which the reader waits from now on
            with self._database.read() as session:
                _, self._settled_by = _transactions(session)
            self._missed, self._missed_at_s = missed, time.monotonic()
        self.number = before
        return there

    def _is_settled(self, before: int, open_since: int) -> bool:
        """Return whether no event will be added any more in the gap that follows a number."""
        if self._sequential:
            return True
        waited_s = time.monotonic() - self._missed_at_s
        return self._missed == before and open_since >= self._settled_by and waited_s >= _SHORTEST_WAIT_S

    def _newest(self, session: Session) -> int:
        """Return the newest number through which all events are written."""
        if self._sequential:
            return newest_number(session)
        # One statement: it sees the rows of transactions that had ended by then, and no other rows.
        last, open_since, not_begun = session.execute(_NEWEST).one()
        if open_since == not_begun:
            return last or 0
        since = self._database.now() - _LONGEST_TRANSACTION
        newest_first = select(EventRow.number, EventRow.at).order_by(EventRow.number.desc()).limit(_LOOKED_THROUGH)
        recent = [row.number for row in takewhile(lambda row: row.at >= since, session.execute(newest_first))]
        older = select(func.max(EventRow.number)).where(EventRow.number < min(recent, default=0))
        numbers = [*recent, session.scalar(older) or 0]
        return min((before for number, before in pairwise(numbers) if number > before + 1), default=last or 0)


def newest_number(session: Session) -> int:
    """Return the number of the newest written event; 0: there is none."""
    return session.scalar(select(func.max(EventRow.number))) or 0


def _transactions(session: Session) -> tuple[int, int]:
    open_since, not_begun = session.execute(_OPEN).one()
    return open_since, not_begun


def published() -> ColumnElement[bool]:
    """Return a condition for statements: the feed publishes the event."""
    return EventRow.type.not_in([kind for kind in EventType.all() if not kind.is_public])
