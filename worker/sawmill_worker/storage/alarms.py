"""Alarms of absence. A row is an open alarm: written once when its limit is passed, removed once it has ended."""

from collections.abc import Iterator
from datetime import UTC, datetime, time, timedelta
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, ScalarSelect, delete, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from sawmill_worker.contracts.alarms import Alarm, AlarmKind
from sawmill_worker.contracts.events import EventKind
from sawmill_worker.contracts.phantoms import SizeMeasurement
from sawmill_worker.contracts.scanners import AlarmLimits
from sawmill_worker.contracts.scans import ScanState
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.events import announce
from sawmill_worker.storage.tables import AlarmRow, PhantomRow, ScannerRow, ScanRow

_OF_A_PHANTOM = (ScanRow.phantom_id.is_not(None), ScanRow.state != ScanState.REFUSED)


class AlarmChange(NamedTuple):
    """An alarm that was opened, or that has ended."""

    what: EventKind
    alarm: Alarm


class Alarms:
    """Every method is one transaction, `check` one for each scanner whose alarms change."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def open(self, *, scanner_id: str | None = None) -> list[Alarm]:
        """Those that are open, of all scanners or of one."""
        with self._database.read() as session:
            return _opened(session, scanner_id)

    def check(self) -> list[AlarmChange]:
        """Open what is missing by now and close what has come: once each, however many processes look."""
        now = self._database.now()
        with self._database.read() as session:
            changing = {change.alarm.scanner_id for change in _changes(session, now)}
        return [change for scanner_id in sorted(changing) for change in self._bring_up_to_date(scanner_id, now)]

    def _bring_up_to_date(self, scanner_id: str, now: datetime) -> list[AlarmChange]:
        with self._database.write() as session:
            # Of several processes, the second one finds what the first has written.
            session.execute(select(ScannerRow.id).where(ScannerRow.id == scanner_id).with_for_update())
            changes = _changes(session, now, scanner_id)
            for what, alarm in changes:
                if what is EventKind.ALARM_OPENED:
                    session.add(AlarmRow(**alarm.model_dump()))
                else:
                    ended = AlarmRow.scanner_id == scanner_id, AlarmRow.what == alarm.what
                    session.execute(delete(AlarmRow).where(*ended))
                detail = alarm.model_dump(mode="json", exclude={"scanner_id"}, exclude_none=True)
                announce(session, now, what, "scanner", scanner_id, scanner_id=scanner_id, detail=detail)
            return changes


def _changes(session: Session, now: datetime, scanner_id: str | None = None) -> list[AlarmChange]:
    """Alarms that have ended, then those that are new; one with another limit is another alarm."""
    opened, due = _opened(session, scanner_id), list(_due(session, now, scanner_id))
    ended = [AlarmChange(EventKind.ALARM_CLOSED, alarm) for alarm in opened if alarm not in due]
    return ended + [AlarmChange(EventKind.ALARM_OPENED, alarm) for alarm in due if alarm not in opened]


def _opened(session: Session, scanner_id: str | None) -> list[Alarm]:
    statement = select(AlarmRow).order_by(AlarmRow.scanner_id, AlarmRow.what)
    if scanner_id is not None:
        statement = statement.where(AlarmRow.scanner_id == scanner_id)
    rows = session.scalars(statement)
    return [Alarm.model_validate({name: getattr(row, name) for name in Alarm.model_fields}) for row in rows]


def _due(session: Session, now: datetime, scanner_id: str | None) -> Iterator[Alarm]:
    """Every alarm that should be open now."""
    statement = (
        select(
            ScannerRow,
            _newest(ScanRow.created_at),
            _newest(ScanRow.created_at, *_OF_A_PHANTOM),
            PhantomRow.id,
            PhantomRow.drawing["measurements"],
        )
        .select_from(ScannerRow)
        .outerjoin(PhantomRow, PhantomRow.id == _newest(ScanRow.phantom_id, *_OF_A_PHANTOM))
    )
    if scanner_id is not None:
        statement = statement.where(ScannerRow.id == scanner_id)
    for scanner, scan_at, phantom_scan_at, phantom_id, measurements in session.execute(statement):
        limits = AlarmLimits.model_validate(scanner.spec.get("alarms", {}))
        every_days = limits.phantom_scan_every_days
        for what, newest_at, limit_hours in (
            (AlarmKind.NO_PHANTOM_SCAN, phantom_scan_at, None if every_days is None else 24.0 * every_days),
            (AlarmKind.SCANNER_QUIET, scan_at, limits.quiet_after_hours),
        ):
            last_at = newest_at or scanner.created_at
            if limit_hours is not None and (since := last_at + timedelta(hours=limit_hours)) <= now:
                yield Alarm(scanner_id=scanner.id, what=what, since=since, last_at=last_at, limit_hours=limit_hours)
        measured = [SizeMeasurement.model_validate(each) for each in measurements or ()]
        if expired := [each.expires_on for each in measured if each.expires_on and each.expired(now.date())]:
            yield Alarm(
                scanner_id=scanner.id,
                what=AlarmKind.PHANTOM_EXPIRED,
                since=datetime.combine(min(expired) + timedelta(days=1), time(), UTC),
                phantom_id=phantom_id,
                expired_on=min(expired),
            )


def _newest(column: InstrumentedAttribute[Any], *conditions: ColumnElement[bool]) -> ScalarSelect[Any]:
    """Of the scanner's newest scan of which the conditions are true."""
    mine = select(column).where(ScanRow.scanner_id == ScannerRow.id, *conditions)
    return mine.order_by(ScanRow.created_at.desc()).limit(1).correlate(ScannerRow).scalar_subquery()
