"""Rules of retention: kept as one row, previewed, and put into force with a confirmed number of removals."""

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Select, and_, func, null, select, text
from sqlalchemy.orm import Session

from sawmill_contracts.retention import (
    Going,
    KindPreview,
    Removed,
    Retention,
    RetentionAsk,
    RetentionKind,
    RetentionPreview,
    RetentionRules,
    Staying,
    StaysBecause,
)
from sawmill_platform.acting import actor
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.retention import limits_of, rule_name
from sawmill_platform.database.database import Database, lock_for_setup
from sawmill_platform.database.tables import REMOVABLE, EventRow, RetentionRow
from sawmill_platform.errors import Conflict
from sawmill_platform.ledger.audit import changed
from sawmill_platform.ledger.events import announce
from sawmill_platform.retention.growth import Growth, filling_of, growth_of
from sawmill_platform.retention.retention_runner import SUBJECT, THE_ROW, waits_since
from sawmill_platform.retention.stocks import Protection, Stock, last_old_event, none_of, reach_of
from sawmill_store.retention.stocks import STOCKS, events_kept_by

RULES = "rules"
# Time for a person to confirm the number of a preview: scans become too old every few seconds.
CONFIRMED_WITHIN = timedelta(hours=1)
_FIRST, _FIRST_IDS = 10, 3


class RetentionStore:
    """Store of the rules of retention: every method is one transaction; `replace` is two."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def get(self) -> Retention:
        """Return the rules in force, and the totals that rules have removed so far."""
        with self._database.read() as session:
            return read_retention(session.get(RetentionRow, THE_ROW), self._database.now())

    def preview(self, rules: RetentionRules) -> RetentionPreview:
        """List what rules would remove within the time for a confirmation, and what would stay though it is reached."""
        with self._database.read() as session:
            return _preview(session, rules, self._database.now() + CONFIRMED_WITHIN)

    def growth(self, free_bytes: float) -> Growth:
        """Compute the growth of files, and the time until the free bytes are used up under the rules in force."""
        with self._database.read() as session:
            rules = rules_of(session.get(RetentionRow, THE_ROW))
            now, stocks = self._database.now(), [stock for stock in STOCKS.values() if stock.has_bytes]
            kinds = [filling_of(session, stock, limits_of(dict(rules), stock.kind), now) for stock in stocks]
            return growth_of(kinds, free_bytes)

    def replace(self, ask: RetentionAsk) -> Retention:
        """Put rules into force, if they remove no more than was confirmed.

        Raises
        ------
        Conflict
            The rules would remove more.
        """
        rules = RetentionRules(**{name: getattr(ask, name) for name in RetentionRules.model_fields})
        with self._database.read() as session:
            shown = _preview(session, rules, self._database.now())
        if shown.number > ask.remove_at_most:
            raise _unconfirmed(shown, ask.remove_at_most)
        with self._database.write() as session:
            lock_for_setup(session)
            row = session.get(RetentionRow, THE_ROW, with_for_update=True)
            before, after = (each.model_dump(mode="json") for each in (rules_of(row), rules))
            if row is None:
                row = RetentionRow(number=THE_ROW, removed={})
                session.add(row)
            now = self._database.now()
            row.rules, row.changed_at, row.changed_by = after, now, actor().name
            row.revision = (row.revision or 0) + 1
            row.followed_at = None
            difference = changed(before, after)
            announce(session, now, event_kinds.RETENTION_CHANGED, SUBJECT, RULES, decided=difference)
            return read_retention(row, now)


def rules_of(row: RetentionRow | None) -> RetentionRules:
    """Read the rules of the row; without a row there are no rules."""
    return RetentionRules() if row is None else RetentionRules.model_validate(row.rules)


def read_retention(row: RetentionRow | None, now: datetime) -> Retention:
    """Read the rules and their totals; without a row there are no rules."""
    removed = {} if row is None else row.removed
    return Retention(
        rules=rules_of(row),
        changed_at=None if row is None else row.changed_at,
        changed_by=None if row is None else row.changed_by,
        days_wait_since=None if row is None else waits_since(row, now),
        removed=[
            Removed(kind=kind, number=number, freed_bytes=freed_bytes)
            for kind in RetentionKind
            for number, freed_bytes in [removed.get(kind.value, (0, 0))]
        ],
    )


def _preview(session: Session, rules: RetentionRules, at: datetime) -> RetentionPreview:
    ruled = set(rules.kinds())
    kinds = [_of_kind(session, kind, rules, at) if kind in ruled else _nothing_of(kind) for kind in RetentionKind]
    return RetentionPreview(at=at, rules=rules, number=sum(kind.number for kind in kinds), kinds=kinds)


def _unconfirmed(shown: RetentionPreview, confirmed: int) -> Conflict:
    removed = ", ".join(f"{kind.number} {kind.kind}" for kind in shown.kinds if kind.number)
    detail = f"these rules would remove {shown.number} ({removed}), and {confirmed} are confirmed: nothing was changed"
    return Conflict("retention-unconfirmed", detail)


def _nothing_of(kind: RetentionKind) -> KindPreview:
    return KindPreview(kind=kind, number=0, bytes=None, oldest_at=None, newest_at=None, first=[], stays=[])


def _of_kind(session: Session, kind: RetentionKind, rules: RetentionRules, at: datetime) -> KindPreview:
    stock = STOCKS.get(kind)
    return _of_events(session, rules, at) if stock is None else _of_stock(session, stock, rules, at)


def _of_stock(session: Session, stock: Stock, rules: RetentionRules, at: datetime) -> KindPreview:
    table, reach = stock.table, reach_of(session, stock, limits_of(dict(rules), stock.kind), at)
    kept = list(stock.kept_by(session))
    reached = reach.beyond()
    goes = and_(reached, none_of(kept))
    sized = stock.all_bytes if stock.has_bytes else null()
    totals = stock.select(func.count(), sized, func.min(table.created_at), func.max(table.created_at), until=goes)
    number, size, oldest_at, newest_at = session.execute(totals).one()
    columns = (table.id, table.created_at, table.stored_bytes if stock.has_bytes else null())
    first = session.execute(stock.select(*columns, until=goes).order_by(table.created_at, table.id).limit(_FIRST))
    return KindPreview(
        kind=RetentionKind(stock.kind),
        number=number,
        bytes=size,
        oldest_at=oldest_at,
        newest_at=newest_at,
        first=[
            Going(id=identifier, created_at=made_at, bytes=each, by=rule_name(stock.kind, reach.unit_for(made_at)))
            for identifier, made_at, each in first
        ],
        stays=_staying(session, kept, stock.select(table.id, until=reached).order_by(table.created_at, table.id)),
    )


def _of_events(session: Session, rules: RetentionRules, at: datetime) -> KindPreview:
    last, kept = last_old_event(session, rules.events_days, at), list(events_kept_by(session))
    reached = and_(text(REMOVABLE), EventRow.number <= last)
    goes = and_(reached, none_of(kept))
    number = session.scalar(select(func.count()).select_from(EventRow).where(goes)) or 0
    oldest = select(EventRow.number, EventRow.at).where(goes).order_by(EventRow.number).limit(_FIRST)
    first = [
        Going(id=str(each), created_at=happened_at, bytes=None, by=rule_name(RetentionKind.EVENTS, "days"))
        for each, happened_at in session.execute(oldest)
    ]
    newest_at = session.scalar(select(EventRow.at).where(goes).order_by(EventRow.number.desc()).limit(1))
    return KindPreview(
        kind=RetentionKind.EVENTS,
        number=number,
        bytes=None,
        oldest_at=first[0].created_at if first else None,
        newest_at=newest_at,
        first=first,
        stays=_staying(session, kept, select(EventRow.number).where(reached).order_by(EventRow.number)),
    )


def _staying(session: Session, protections_of_kind: Sequence[Protection], reached: Select[Any]) -> list[Staying]:
    """Count the rows that the rules reach and that stay, by reason, with the ids of the oldest rows."""
    staying = []
    for because, condition in protections_of_kind:
        staying_rows = reached.where(condition)
        counted = staying_rows.with_only_columns(func.count(), maintain_column_froms=True).order_by(None)
        number = session.scalar(counted) or 0
        if number:
            first_ids = [str(each) for each in session.scalars(staying_rows.limit(_FIRST_IDS))]
            staying.append(Staying(because=StaysBecause(because), number=number, first_ids=first_ids))
    return staying
