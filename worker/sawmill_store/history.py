"""Histories of scanners (`sawmill_store/history_writer.py` writes them): pages, charts, and files with the oldest first."""

from collections.abc import Iterator
from datetime import datetime
from typing import Any

from sqlalchemy import Row, Select, and_, select, tuple_

from sawmill_contracts.history import HistoryEntry, HistoryKind, HistoryMark
from sawmill_platform.contracts.base import Page
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import LARGEST_NUMBER, cursor_of, found, parse_cursor
from sawmill_platform.database.tables import Resource
from sawmill_platform.errors import Invalid
from sawmill_store.measurements import read_measurement
from sawmill_store.tables import CalibrationRow, DriftRow, HistoryRow, MeasurementRow, ScannerRow, ScanRow, ScheduleRow

_BATCH = 500
# Where what an entry is about is stored, and listed below /v1/.
SUBJECTS: dict[str, tuple[type[Resource], str]] = {
    "calibration": (CalibrationRow, "calibrations"),
    "drift": (DriftRow, "drifts"),
    "scanner": (ScannerRow, "scanners"),
    "schedule": (ScheduleRow, "schedules"),
    "scan": (ScanRow, "scans"),
}
_Place = tuple[datetime, int]


class Histories:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

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
        """One scanner's, newest first.

        Parameters
        ----------
        kind
            Entries of this kind; null: all.
        since, until
            Not before the one, and before the other; null: no bound.
        after, limit
            The cursor that an earlier page gave, and how many.

        Raises
        ------
        NotFound, Invalid
            There is no such scanner; `after` is not a cursor that an earlier page gave.
        """
        statement = _entries(scanner_id, kind, since, until)
        if after is not None:
            statement = statement.where(tuple_(*_place(after)) > _PLACE)
        newest_first = statement.order_by(HistoryRow.at.desc(), HistoryRow.number.desc()).limit(limit + 1)
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
        """One scanner's, the oldest first, some hundreds at a time and a transaction for each; or `NotFound`."""
        with self._database.read() as session:
            found(session, ScannerRow, "scanner", scanner_id)
        return self._batches(_entries(scanner_id, kind, since, until))

    def marks(self, scanner_id: str, since: datetime) -> list[HistoryMark]:
        """Activations and alarms since a time, the oldest first: what a chart of measurements marks."""
        marked = HistoryRow.kind.in_((HistoryKind.ACTIVATION, HistoryKind.ALARM))
        statement = select(*(getattr(HistoryRow, name) for name in HistoryMark._fields))
        statement = statement.where(HistoryRow.scanner_id == scanner_id, HistoryRow.at >= since, marked)
        with self._database.read() as session:
            rows = session.execute(statement.order_by(HistoryRow.at, HistoryRow.number))
            return [HistoryMark(*row) for row in rows]

    def activation_of(self, scanner_id: str, calibration_id: str) -> HistoryEntry | None:
        """The newest activation of a calibration; None: it was never the active one."""
        its = _entries(scanner_id, HistoryKind.ACTIVATION, None, None).where(HistoryRow.subject_id == calibration_id)
        with self._database.read() as session:
            row = session.execute(its.order_by(HistoryRow.at.desc(), HistoryRow.number.desc()).limit(1)).one_or_none()
            return None if row is None else _read(row)

    def _batches(self, statement: Select[Any]) -> Iterator[list[HistoryEntry]]:
        oldest_first, last = statement.order_by(HistoryRow.at, HistoryRow.number).limit(_BATCH), None
        while batch := self._following(oldest_first, last):
            yield batch
            last = (batch[-1].at, batch[-1].number)

    def _following(self, statement: Select[Any], last: _Place | None) -> list[HistoryEntry]:
        following = statement if last is None else statement.where(tuple_(*last) < _PLACE)
        with self._database.read() as session:
            return [_read(row) for row in session.execute(following)]


# Rows compare as wholes, so that an index by time finds where a page begins.
_PLACE = tuple_(HistoryRow.at, HistoryRow.number)


def _place(cursor: str) -> _Place:
    moment, number = parse_cursor(cursor)
    if not number.isdecimal() or int(number) > LARGEST_NUMBER:
        raise Invalid("invalid-cursor", f"after must be the next of an earlier page, not {cursor!r}")
    return moment, int(number)


def _entries(scanner_id: str, kind: HistoryKind | None, since: datetime | None, until: datetime | None) -> Select[Any]:
    """The rows with what they measured, and with the ids of what they are about where that is stored still."""
    columns: list[Any] = [HistoryRow, MeasurementRow, *(row.id.label(noun) for noun, (row, _) in SUBJECTS.items())]
    statement = select(*columns).outerjoin(MeasurementRow, MeasurementRow.number == HistoryRow.measurement_number)
    for noun, (row, _) in SUBJECTS.items():
        statement = statement.outerjoin(row, and_(HistoryRow.subject == noun, row.id == HistoryRow.subject_id))
    bounds = [
        HistoryRow.scanner_id == scanner_id,
        None if kind is None else HistoryRow.kind == kind,
        None if since is None else HistoryRow.at >= since,
        None if until is None else HistoryRow.at < until,
    ]
    return statement.where(*(bound for bound in bounds if bound is not None))


def _read(found: Row[Any]) -> HistoryEntry:
    stored = found._mapping.get(found.HistoryRow.subject) is not None  # noqa: SLF001 - public, as named tuples have it
    return read_entry(found.HistoryRow, found.MeasurementRow, stored=stored)


def read_entry(entry: HistoryRow, measured: MeasurementRow | None, *, stored: bool) -> HistoryEntry:
    """The entry of a row, with what it measured, and with a link where its subject is stored still."""
    names = HistoryEntry.model_fields.keys() - {"link", "measured"}
    return HistoryEntry(
        **{name: getattr(entry, name) for name in names},
        link=f"/v1/{SUBJECTS[entry.subject][1]}/{entry.subject_id}" if stored else None,
        measured=None if measured is None else read_measurement(measured),
    )
