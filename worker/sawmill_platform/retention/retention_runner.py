"""Execution of the rules of retention: oldest rows first, a few in a transaction, rows first and then files.

A kill between rows and files leaves files that no row names, which `leftovers` removes. Rows chosen for removal are
locked and checked again: a job or another use since the choice keeps a row.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import structlog
from sqlalchemy import CursorResult, and_, delete, or_, select, text, update
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.retention import limits_of
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import REMOVABLE, EventRow, JobDependencyRow, JobRow, RetentionRow
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.ledger.events import announce
from sawmill_platform.retention.leftovers import noted
from sawmill_platform.retention.measured_bytes import freed_bytes_of, measure_some, places_of
from sawmill_platform.retention.stocks import KeptBy, Reach, Stock, last_old_event, none_of, reach_of

THE_ROW = 1
SUBJECT = "retention"
EVENTS = "events"
"""Kind of events in rules; all other kinds are stocks."""
# After a gap of this length, in which no process ran or the clock leapt, rules by days wait for a person.
LONGEST_GAP = timedelta(days=30)
EVERY_S = 600.0
# Rows in a transaction: their files of 230 MB each are deleted within the time of a round.
ITEMS_A_ROUND = 50
EVENTS_A_ROUND = 2000
_log = structlog.get_logger()


class Removal(NamedTuple):
    """Number and freed bytes of removed objects of one kind."""

    kind: str
    number: int
    freed_bytes: int


class RetentionKeeper:
    """Remover of everything that the rules reach, a batch a round; one of several processes works at a time.

    Parameters
    ----------
    database, files
        Database and data folder, on which several processes may work.
    stocks
        Rows that rules of retention reach, by kind.
    events_kept_by
        Function that returns what keeps events.
    now_s
        The keeper's clock, which never goes back.
    """

    def __init__(
        self,
        database: Database,
        files: FileStore,
        stocks: Mapping[str, Stock],
        events_kept_by: KeptBy,
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = database
        self._files = files
        self._stocks = stocks
        self._events_kept_by = events_kept_by
        self._now_s = now_s
        self._due_s = now_s()
        self._measures = False
        self._known: int | None = None
        self._reaches: list[Reach | int] = []  # of each stock, and for events the number of the last event

    def remove_some(self) -> Removal | None:
        """Measure new files and remove the next batch, if there is one: every ten minutes, and after a change of rules.

        Returns
        -------
        Removal or None
            Summary of the removed batch. None: nothing that the rules reach may go now.

        Raises
        ------
        StorageFull, StorageUnavailable
            The database cannot write.
        OSError
            A file could not be removed: its row is gone, and `leftovers` will remove the file.
        """
        with self._database.read() as session:
            revision = session.scalar(select(RetentionRow.revision).where(RetentionRow.number == THE_ROW))
        is_due = self._now_s() >= self._due_s
        if is_due or self._measures:
            self._measures = measure_some(self._database, self._files, self._stocks.values())
        if is_due or revision != self._known:
            self._due_s, self._known, self._reaches = self._now_s() + EVERY_S, revision, self._find_reaches()
        while self._reaches:
            reach = self._reaches.pop(0)
            removed, is_full = self._remove_events(reach) if isinstance(reach, int) else self._remove_stored(reach)
            if is_full:
                self._reaches.insert(0, reach)
            if removed is not None:
                return removed
        return None

    def _find_reaches(self) -> list[Reach | int]:
        now = self._database.now()
        with self._database.read() as session:
            row = session.get(RetentionRow, THE_ROW)
            if row is None:
                return []
            waits, limits = (
                waits_since(row, now),
                {kind: limits_of(row.rules, kind) for kind in (*self._stocks, EVENTS)},
            )
            if waits is not None:  # the clock may have leapt, so that everything seems too old
                _log.warning("retention-days-wait", since=waits.isoformat())
                limits = {kind: each._replace(days=None) for kind, each in limits.items()}
            ruled = [stock for kind, stock in self._stocks.items() if any(limits[kind])]
            reaches: list[Reach | int] = [reach_of(session, stock, limits[stock.kind], now) for stock in ruled]
            if any(limits[EVENTS]):
                reaches.append(last_old_event(session, limits[EVENTS].days, now))
        if waits is None:
            with self._database.write() as session:
                same = RetentionRow.number == THE_ROW, RetentionRow.revision == row.revision
                session.execute(update(RetentionRow).where(*same).values(followed_at=now))
        return reaches

    def _remove_stored(self, reach: Reach) -> tuple[Removal | None, bool]:
        """Remove a batch of a stock; return the summary, and whether there may be more."""
        stock = reach.stock
        with self._database.read() as session:
            chosen = _oldest(session, reach)
        if not chosen:
            return None, False
        is_full = len(chosen) == ITEMS_A_ROUND
        with self._database.write() as session:
            row = _held_rules(session, self._known)
            if row is None:
                return None, False
            _lock(session, stock, chosen)
            going = _may_still_go(session, stock, chosen)
            if not going:
                return None, is_full
            places = [place for identifier in going for place in places_of(self._files, stock.job, identifier)]
            removed = Removal(stock.kind, len(going), freed_bytes_of(places))
            _delete(session, stock, list(going))
            self._note(session, row, removed, min(going.values()), max(going.values()))
        self._delete_files(places)
        return removed, is_full

    def _remove_events(self, last: int) -> tuple[Removal | None, bool]:
        """Remove a batch of events; the result is as in `_remove_stored`."""
        with self._database.write() as session:
            row = _held_rules(session, self._known)
            if row is None:
                return None, False
            goes = text(REMOVABLE), EventRow.number <= last, none_of(self._events_kept_by(session))
            oldest = select(EventRow.number, EventRow.at).where(*goes).order_by(EventRow.number).limit(EVENTS_A_ROUND)
            chosen = session.execute(oldest).all()
            if not chosen:
                return None, False
            up_to = EventRow.number <= chosen[-1].number
            gone = session.execute(delete(EventRow).where(up_to, *goes).execution_options(synchronize_session=False))
            assert isinstance(gone, CursorResult)  # noqa: S101 - of a DELETE
            removed = Removal(EVENTS, gone.rowcount, 0)
            self._note(session, row, removed, chosen[0].at, chosen[-1].at)
            return removed, len(chosen) == EVENTS_A_ROUND

    def _note(
        self, session: Session, row: RetentionRow, removed: Removal, first_at: datetime, last_at: datetime
    ) -> None:
        """Count and announce removed rows, in the transaction that removes the rows."""
        number, freed_bytes = row.removed.get(removed.kind, (0, 0))
        counted = [number + removed.number, freed_bytes + removed.freed_bytes]
        row.removed = {**row.removed, removed.kind: counted}
        detail = {
            "number": removed.number,
            "freed_bytes": removed.freed_bytes,
            "first_at": first_at.isoformat(),
            "last_at": last_at.isoformat(),
        }
        now = self._database.now()
        announce(session, now, event_kinds.RETENTION_REMOVED, SUBJECT, removed.kind, detail=detail)

    def _delete_files(self, places: Sequence[Path]) -> None:
        errors = list[OSError]()
        for place in places:
            with noted(errors):
                self._files.remove(place)
        if errors:
            raise errors[0]


def waits_since(row: RetentionRow, now: datetime) -> datetime | None:
    """Return the time when days were last counted, if a person must confirm the rules after so long; otherwise None."""
    last = row.followed_at or row.changed_at
    return last if now - last > LONGEST_GAP else None


def _held_rules(session: Session, revision: int | None) -> RetentionRow | None:
    """Lock and return the row of the rules; None where another process has locked it, or the rules have changed."""
    held = select(RetentionRow).where(RetentionRow.number == THE_ROW, RetentionRow.revision == revision)
    return session.scalar(held.with_for_update(skip_locked=True))


def _oldest(session: Session, reach: Reach) -> Sequence[str]:
    """Read the ids of the oldest rows that may go."""
    stock, table = reach.stock, reach.stock.table
    goes = stock.select(table.id, until=and_(reach.beyond(), none_of(stock.kept_by(session))))
    return session.scalars(goes.order_by(table.created_at, table.id).limit(ITEMS_A_ROUND)).all()


def _may_still_go(session: Session, stock: Stock, chosen: Sequence[str]) -> dict[str, datetime]:
    """Return the times, by id, of the locked rows that may still go."""
    table = stock.table
    rows = select(table.id, table.created_at).where(table.id.in_(chosen), none_of(stock.kept_by(session)))
    return {row.id: row.created_at for row in session.execute(rows)}


def _lock(session: Session, stock: Stock, identifiers: Sequence[str]) -> None:
    """Lock rows against transactions that use or delete them; the rows to which they belong are locked first.

    A request locks the row that it refers to, and then refers to that row's owner: that request must not wait for this
    transaction. SQLite has one writer at a time: it needs no locks, and takes none.
    """
    table = stock.table
    owner_id, key = stock.owner
    owners = select(key).where(key.in_(select(owner_id).where(table.id.in_(identifiers)))).order_by(key)
    session.execute(owners.with_for_update(key_share=True))
    session.execute(select(table.id).where(table.id.in_(identifiers)).order_by(table.id).with_for_update())


def _delete(session: Session, stock: Stock, identifiers: Sequence[str]) -> None:
    """Delete the rows, and their jobs unless these stay."""
    table = stock.table
    job_ids = session.scalars(select(table.job_id).where(table.id.in_(identifiers))).all()
    if stock.forget is not None:
        stock.forget(session, identifiers)
    statements = [delete(table).where(table.id.in_(identifiers))]
    if not stock.jobs_stay:
        waited = or_(JobDependencyRow.job_id.in_(job_ids), JobDependencyRow.needs_job_id.in_(job_ids))
        statements.insert(0, delete(JobDependencyRow).where(waited))
        statements.append(delete(JobRow).where(JobRow.id.in_(job_ids)))
    for statement in statements:
        session.execute(statement.execution_options(synchronize_session=False))
