"""Who did what: written in the transaction of the change itself, and changed or removed by nothing (migration 0007)."""

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from sawmill_platform.acting import actor
from sawmill_platform.contracts.audit import AuditEntry
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.event_kinds import EventKind
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import read_numbered_page
from sawmill_platform.database.tables import AuditRow

_BATCH = 500


def write_audit(
    session: Session, now: datetime, action: EventKind, subject_id: str, detail: dict[str, Any] | None = None
) -> None:
    """Add what whoever acts does."""
    who = actor()
    session.add(
        AuditRow(
            at=now,
            who=who.name,
            key_id=who.key_id,
            address=who.address,
            request_id=who.request_id,
            action=action,
            subject_id=subject_id,
            detail=detail,
        )
    )


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
                session, select(AuditRow), AuditRow.number, read_audit_entry, after=after, limit=limit
            )

    def all(self) -> Iterator[AuditEntry]:
        """Every entry, the oldest first; a transaction for each few hundred."""
        last = 0
        while entries := self._following(last):
            yield from entries
            last = entries[-1].number

    def extent(self) -> tuple[int, int]:
        """How many entries there are, and the newest one's number: the same as long as none is added."""
        statement = select(func.count(), func.coalesce(func.max(AuditRow.number), 0)).select_from(AuditRow)
        with self._database.read() as session:
            count, newest = session.execute(statement).one()
        return count, newest

    def _following(self, number: int) -> list[AuditEntry]:
        statement = select(AuditRow).where(AuditRow.number > number).order_by(AuditRow.number).limit(_BATCH)
        with self._database.read() as session:
            return [read_audit_entry(row) for row in session.scalars(statement)]


def read_audit_entry(row: AuditRow) -> AuditEntry:
    """The entry of a row."""
    return AuditEntry.model_validate({column.key: getattr(row, column.key) for column in AuditRow.__table__.columns})
