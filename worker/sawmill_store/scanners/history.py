"""Histories of scanners, which are queries on the ledger: pages, charts, and files with the oldest first."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import Row, Select, and_, func, select, text, tuple_, update
from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.history import HistoryEntry, HistoryKind, HistoryMark
from sawmill_contracts.measurements import Measurement
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.base import Page
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.paging import LARGEST_NUMBER, cursor_of, found, parse_cursor
from sawmill_platform.database.tables import IN_HISTORY, EventClass, EventRow, Resource
from sawmill_platform.errors import Invalid
from sawmill_store.mill_tables import CalibrationRow, DriftRow, MeasurementRow, ScannerRow, ScanRow, ScheduleRow

_BATCH = 500
# The table of each subject of an entry, and its path below /v1/.
SUBJECTS: dict[str, tuple[type[Resource], str]] = {
    "calibration": (CalibrationRow, "calibrations"),
    "drift": (DriftRow, "drifts"),
    "scanner": (ScannerRow, "scanners"),
    "schedule": (ScheduleRow, "schedules"),
    "scan": (ScanRow, "scans"),
}


class Histories(StorePart):
    """Store of scanners' histories."""

    def page(
        self,
        scanner_id: str,
        *,
        kind: HistoryKind | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[HistoryEntry]:
        """Return a page of a scanner's history, newest first.

        Parameters
        ----------
        kind
            Kind of the entries; null: all kinds.
        since, until
            Span of time, `until` excluded; null: no bound.
        after, limit
            Cursor that an earlier page gave, and the largest number of entries.

        Raises
        ------
        NotFound, Invalid
            There is no such scanner; `after` is not a cursor that an earlier page gave.
        """
        statement = _entries(scanner_id, kind, since, until)
        if after is not None:
            moment, number = parse_cursor(after)
            if not number.isdecimal() or int(number) > LARGEST_NUMBER:
                raise Invalid("invalid-cursor", f"after must be the next of an earlier page, not {after!r}")
            statement = statement.where(tuple_(moment, int(number)) > _PLACE)
        newest_first = statement.order_by(EventRow.at.desc(), EventRow.number.desc()).limit(limit + 1)
        with self._database.read() as session:
            found(session, ScannerRow, "scanner", scanner_id)
            items = [_read(row) for row in session.execute(newest_first)]
        shown = items[:limit]
        following = cursor_of(shown[-1].at, str(shown[-1].number)) if len(items) > limit else None
        return Page[HistoryEntry](items=shown, next=following)

    def all(
        self,
        scanner_id: str,
        *,
        kind: HistoryKind | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
    ) -> Iterator[list[HistoryEntry]]:
        """Read a scanner's history, oldest first, some hundred entries in each transaction; or raise `NotFound`."""
        with self._database.read() as session:
            found(session, ScannerRow, "scanner", scanner_id)
        return self._batches(_entries(scanner_id, kind, since, until))

    def marks(self, scanner_id: str, since: datetime) -> list[HistoryMark]:
        """Return the activations and alarms since a time, oldest first: the marks in a chart of measurements."""
        topics = (HistoryKind.ACTIVATION, HistoryKind.ALARM)
        statement = _events(scanner_id).where(EventRow.at >= since, EventRow.topic.in_(topics))
        with self._database.read() as session:
            return [
                HistoryMark(row.at, HistoryKind(row.topic or ""), row.type, row.subject_id or "", _alarm(row))
                for row in session.scalars(statement.order_by(EventRow.at, EventRow.number))
            ]

    def newest(self, scanner_id: str, kind: HistoryKind, subject_id: str) -> HistoryEntry | None:
        """Return the newest entry of a kind about a subject, as an activation of a calibration; None: there is none."""
        entries = _entries(scanner_id, kind, None, None).where(EventRow.subject_id == subject_id)
        with self._database.read() as session:
            row = session.execute(entries.order_by(EventRow.at.desc(), EventRow.number.desc()).limit(1)).one_or_none()
            return None if row is None else _read(row)

    def _batches(self, statement: Select[Any]) -> Iterator[list[HistoryEntry]]:
        oldest_first = following = statement.order_by(EventRow.at, EventRow.number).limit(_BATCH)
        while True:
            with self._database.read() as session:
                batch = [_read(row) for row in session.execute(following)]
            if not batch:
                return
            yield batch
            following = oldest_first.where(tuple_(batch[-1].at, batch[-1].number) < _PLACE)


# Both columns are compared as one row value, so that an index by time finds the start of a page.
_PLACE = tuple_(EventRow.at, EventRow.number)


def _events(scanner_id: str) -> Select[EventRow]:
    """Select the events of a scanner's history since a scanner with the same id was last deleted."""
    deleted = select(func.max(EventRow.number)).where(
        EventRow.group_id == scanner_id, EventRow.type == mill_events.SCANNER_DELETED
    )
    since = EventRow.number > func.coalesce(deleted.scalar_subquery(), 0)
    return select(EventRow).where(text(IN_HISTORY), EventRow.group_id == scanner_id, since)


def _entries(scanner_id: str, kind: HistoryKind | None, since: datetime | None, until: datetime | None) -> Select[Any]:
    """Select the events with their measurements, and with the ids of their subjects where these are still stored."""
    columns: list[Any] = [MeasurementRow, *(row.id.label(noun) for noun, (row, _) in SUBJECTS.items())]
    measured = and_(
        EventRow.type == event_kinds.SUCCEEDED,
        MeasurementRow.subject_id == EventRow.subject_id,
        MeasurementRow.kind == EventRow.subject,
    )
    statement = _events(scanner_id).add_columns(*columns).outerjoin(MeasurementRow, measured)
    for noun, (row, _) in SUBJECTS.items():
        statement = statement.outerjoin(row, and_(EventRow.subject == noun, row.id == EventRow.subject_id))
    bounds = [
        None if kind is None else EventRow.topic == kind,
        None if since is None else EventRow.at >= since,
        None if until is None else EventRow.at < until,
    ]
    return statement.where(*(bound for bound in bounds if bound is not None))


def forget_history(session: Session, scanner_id: str) -> None:
    """Leave the history of a scanner that is deleted to the rules of retention; decisions stay in the audit."""
    of_scanner = EventRow.group_id == scanner_id, EventRow.event_class == EventClass.WORK, text(IN_HISTORY)
    session.execute(update(EventRow).where(*of_scanner).values(topic=None).execution_options(synchronize_session=False))


def _read(row: Row[Any]) -> HistoryEntry:
    """Return the entry of an event, with its measurement, and with a link where its subject is still stored."""
    event, measured = row.EventRow, row.MeasurementRow
    stored = row._mapping.get(event.subject) is not None  # noqa: SLF001 - public, as named tuples have it
    subject = event.subject or ""
    return HistoryEntry.of_row(
        event,
        kind=HistoryKind(event.topic or ""),
        alarm=_alarm(event),
        link=f"/v1/{SUBJECTS[subject][1]}/{event.subject_id}" if stored else None,
        measured=None if measured is None else Measurement.of_row(measured),
    )


def _alarm(event: EventRow) -> AlarmKind | None:
    what = (event.detail or {}).get("kind") if event.topic == HistoryKind.ALARM else None
    return None if what is None else AlarmKind(what)


def changes_in_words(difference: Mapping[str, Any]) -> str:
    """Describe changes, given as [before, after] by name, like the audit: `name: "Line 3", was "Line 2"`."""
    words = [f"{name}: {json.dumps(after)}, was {json.dumps(before)}" for name, before, after in _parts(difference)]
    return "; ".join(words) or "nothing was changed"


def _parts(difference: Mapping[str, Any], within: str = "") -> Iterator[tuple[str, Any, Any]]:
    for name, (before, after) in difference.items():
        if isinstance(before, dict) and isinstance(after, dict):
            pairs = {each: (before.get(each), after.get(each)) for each in {**before, **after}}
            yield from _parts({each: pair for each, pair in pairs.items() if pair[0] != pair[1]}, f"{within}{name}.")
        else:
            yield f"{within}{name}", before, after
