"""Rules of retention: kept as one row, previewed, put into force with a confirmed number, and carried out."""

import time
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import structlog
from sqlalchemy import ColumnElement, and_, func, select, update
from sqlalchemy.orm import Session

from sawmill_contracts.retention import (
    KindPreview,
    Removed,
    Retention,
    RetentionKind,
    RetentionPreview,
    RetentionRequest,
    RetentionRules,
)
from sawmill_platform.contracts import event_kinds
from sawmill_platform.database.database import Database, StorePart, lock_for_setup
from sawmill_platform.database.paging import Check, accept_any
from sawmill_platform.errors import Conflict
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.files.named_folders import noted
from sawmill_platform.ledger.audit import changed
from sawmill_platform.ledger.events import actor, announce
from sawmill_store.mill_tables import RetentionRow
from sawmill_store.retention.removable_rows import REMOVABLE_ROWS, RemovableRows, delete_rows, lock

SUBJECT, THE_ROW = "retention", 1
# Time for a person to confirm the number of a preview: scans become too old every few seconds.
CONFIRMED_WITHIN = timedelta(hours=1)
# After a gap of this length, in which no process ran or the clock leapt, rules wait for a person.
LONGEST_GAP = timedelta(days=30)
EVERY_S = 600.0
_log = structlog.get_logger()


class RetentionStore(StorePart):
    """Store of the rules of retention; `replace` is two transactions."""

    def get(self) -> Retention:
        """Return the rules in force, and the totals that rules have removed so far."""
        with self._database.read() as session:
            return read_retention(session.get(RetentionRow, THE_ROW), self._database.now())

    def preview(self, rules: RetentionRules) -> RetentionPreview:
        """Count what rules would remove within the time for a confirmation, and what would stay all the same."""
        with self._database.read() as session:
            return _preview(session, rules, self._database.now() + CONFIRMED_WITHIN)

    def replace(self, ask: RetentionRequest, *, check: Check[Retention] = accept_any) -> Retention:
        """Put rules into force, if they remove no more than was confirmed.

        Raises
        ------
        Conflict
            The rules would remove more.
        """
        rules = RetentionRules(**ask.model_dump(exclude={"remove_at_most"}))
        with self._database.read() as session:
            preview = _preview(session, rules, self._database.now())
        if preview.number > ask.remove_at_most:
            removed = ", ".join(f"{kind.number} {kind.kind}" for kind in preview.kinds if kind.number)
            raise Conflict(
                "retention-unconfirmed",
                f"these rules would remove {preview.number} ({removed}), and {ask.remove_at_most} are confirmed: "
                "nothing was changed",
            )
        with self._database.write() as session:
            lock_for_setup(session)
            row = session.get(RetentionRow, THE_ROW, with_for_update=True)
            check(read_retention(row, self._database.now()))
            before, after = (each.model_dump(mode="json") for each in (_rules_of(row), rules))
            if row is None:
                row = RetentionRow(number=THE_ROW, removed={})
                session.add(row)
            now = self._database.now()
            row.rules, row.changed_at, row.changed_by = after, now, actor().name
            row.revision = (row.revision or 0) + 1
            row.followed_at = None
            announce(session, now, event_kinds.RETENTION_CHANGED, SUBJECT, "rules", decided=changed(before, after))
            return read_retention(row, now)


def _rules_of(row: RetentionRow | None) -> RetentionRules:
    return RetentionRules() if row is None else RetentionRules.model_validate(row.rules)


def read_retention(row: RetentionRow | None, now: datetime) -> Retention:
    """Read the rules and their totals; without a row there are no rules."""
    removed = {} if row is None else row.removed
    return Retention(
        rules=_rules_of(row),
        changed_at=None if row is None else row.changed_at,
        changed_by=None if row is None else row.changed_by,
        days_wait_since=None if row is None else _waits_since(row, now),
        removed=[Removed(kind=kind, number=removed.get(kind, 0)) for kind in RetentionKind],
    )


def _waits_since(row: RetentionRow, now: datetime) -> datetime | None:
    """Return the time when days were last counted, if a person must confirm the rules after so long; otherwise None."""
    last = row.followed_at or row.changed_at
    return last if now - last > LONGEST_GAP else None


def _preview(session: Session, rules: RetentionRules, at: datetime) -> RetentionPreview:
    days = rules.days()
    kinds = [
        _preview_of(session, kind, REMOVABLE_ROWS[kind], days[kind], at)
        if kind in days
        else KindPreview(kind=kind, number=0, oldest_at=None, newest_at=None, stays=0)
        for kind in RetentionKind
    ]
    return RetentionPreview(at=at, rules=rules, number=sum(kind.number for kind in kinds), kinds=kinds)


def _preview_of(session: Session, kind: RetentionKind, rows: RemovableRows, days: int, at: datetime) -> KindPreview:
    reached = rows.reached(session, days, at)
    going = and_(reached, rows.unprotected(session))
    number = _number(session, rows, going)
    ages = select(rows.at).where(going).limit(1)
    oldest_first = rows.oldest_first()
    return KindPreview(
        kind=kind,
        number=number,
        oldest_at=session.scalar(ages.order_by(*oldest_first)),
        newest_at=session.scalar(ages.order_by(*(column.desc() for column in oldest_first))),
        stays=_number(session, rows, reached) - number,
    )


def _number(session: Session, rows: RemovableRows, which: ColumnElement[bool]) -> int:
    return session.scalar(select(func.count()).select_from(rows.table).where(which)) or 0


class Removal(NamedTuple):
    """Number of removed objects of one kind."""

    kind: RetentionKind
    number: int


class RetentionKeeper:
    """Remover of everything that the rules reach: oldest rows first, a batch a round, rows first and then files.

    One of several processes works at a time. A kill between rows and files leaves files that no row names, which
    `Leftovers` removes. Rows chosen for removal are locked and checked again: a job or another use since the choice
    keeps a row.
    """

    def __init__(self, database: Database, files: FileStore) -> None:
        self._database = database
        self._files = files
        self._due_s = time.monotonic()
        self._revision: int | None = None
        self._reached: list[tuple[RetentionKind, ColumnElement[bool]]] = []

    def remove_some(self) -> Removal | None:
        """Remove the next batch, if there is one; the rules are read every ten minutes, and after a change."""
        with self._database.read() as session:
            revision = session.scalar(select(RetentionRow.revision).where(RetentionRow.number == THE_ROW))
        if revision != self._revision or time.monotonic() >= self._due_s:
            self._due_s, self._revision, self._reached = time.monotonic() + EVERY_S, revision, self._find_reached()
        while self._reached:
            kind, reached = self._reached.pop(0)
            removed, is_full = self._remove_batch(kind, REMOVABLE_ROWS[kind], reached)
            if is_full:
                self._reached.insert(0, (kind, reached))
            if removed is not None:
                return removed
        return None

    def _find_reached(self) -> list[tuple[RetentionKind, ColumnElement[bool]]]:
        """Return the condition that the rules reach a row, for each kind with a rule."""
        now = self._database.now()
        with self._database.read() as session:
            row = session.get(RetentionRow, THE_ROW)
            if row is None:
                return []
            waits = _waits_since(row, now)
            if waits is not None:  # the clock may have leapt, so that everything seems too old
                _log.warning("retention-days-wait", since=waits.isoformat())
                return []
            days = _rules_of(row).days()
            reached = [(kind, REMOVABLE_ROWS[kind].reached(session, days[kind], now)) for kind in days]
        with self._database.write() as session:
            same = RetentionRow.number == THE_ROW, RetentionRow.revision == row.revision
            session.execute(update(RetentionRow).where(*same).values(followed_at=now))
        return reached

    def _remove_batch(
        self, kind: RetentionKind, rows: RemovableRows, reached: ColumnElement[bool]
    ) -> tuple[Removal | None, bool]:
        """Remove a batch of a kind; return the summary, and whether there may be more."""
        with self._database.read() as session:
            goes = select(rows.key).where(reached, rows.unprotected(session))
            chosen = session.scalars(goes.order_by(*rows.oldest_first()).limit(rows.batch)).all()
        if not chosen:
            return None, False
        with self._database.write() as session:
            held = select(RetentionRow).where(RetentionRow.number == THE_ROW, RetentionRow.revision == self._revision)
            row = session.scalar(held.with_for_update(skip_locked=True))
            if row is None:  # another process has locked it, or the rules have changed
                return None, False
            lock(session, rows, chosen)
            may_still_go = rows.key.in_(chosen), rows.unprotected(session)
            going = {row[0]: row[1] for row in session.execute(select(rows.key, rows.at).where(*may_still_go))}
            if not going:
                return None, len(chosen) == rows.batch
            delete_rows(session, rows, list(going))
            row.removed = {**row.removed, kind: row.removed.get(kind, 0) + len(going)}
            first_at, last_at = min(going.values()).isoformat(), max(going.values()).isoformat()
            detail = {"number": len(going), "first_at": first_at, "last_at": last_at}
            announce(session, self._database.now(), event_kinds.RETENTION_REMOVED, SUBJECT, kind, detail=detail)
        self._delete_files(rows, list(going))
        return Removal(kind, len(going)), len(chosen) == rows.batch

    def _delete_files(self, rows: RemovableRows, keys: Sequence[Any]) -> None:
        if rows.job is None:
            return
        folders, errors = list[Path](), list[OSError]()
        for key in keys:
            folders += [self._files.results(rows.job, key), self._files.upload(rows.job, key).parent]
        for folder in folders:
            with noted(errors):
                self._files.remove(folder)
        if errors:
            raise errors[0]
