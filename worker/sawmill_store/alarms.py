"""Alarms of absence and of drift. A row is an open alarm: written once when it opens, removed once it has ended."""

from collections.abc import Iterator
from datetime import UTC, datetime, time, timedelta
from typing import Any, NamedTuple

import structlog
from pydantic import TypeAdapter, ValidationError
from sqlalchemy import ColumnElement, ScalarSelect, delete, func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from sawmill_contracts import job_kinds, mill_events
from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.phantoms import SizeMeasurement
from sawmill_contracts.scanners import AlarmLimits
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import EventKind
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_platform.ledger.events import announce
from sawmill_store.activations import active_since
from sawmill_store.tables import AlarmRow, CalibrationRow, DriftChartRow, PhantomRow, ScannerRow, ScanRow

_READY = (ScanRow.phantom_id.is_not(None), ScanRow.state == ScanState.READY)
_COMING = (ScanRow.phantom_id.is_not(None), ScanRow.state != ScanState.REFUSED)
_MEASUREMENTS = TypeAdapter(list[SizeMeasurement])
_NOT_YET = datetime.max.replace(tzinfo=UTC)


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
        """Open what is missing by now and close what has come: once each, however many processes look.

        A scanner whose limits or whose phantom's measurements cannot be read is logged and left as it is.
        """
        with self._database.read() as session:
            changing = {change.alarm.scanner_id for change in _changes(session, self._database.now())}
        return [change for scanner_id in sorted(changing) for change in self._bring_up_to_date(scanner_id)]

    def _bring_up_to_date(self, scanner_id: str) -> list[AlarmChange]:
        with self._database.write() as session:
            # Of several processes, the second one finds what the first has written.
            session.execute(select(ScannerRow.id).where(ScannerRow.id == scanner_id).with_for_update())
            now = self._database.now()
            changes = list(_changes(session, now, scanner_id))
            for what, alarm in changes:
                if what is mill_events.ALARM_OPENED:
                    drift = None if alarm.drift is None else alarm.drift.model_dump(mode="json")
                    session.add(AlarmRow(**alarm.model_dump(exclude={"drift"}), drift=drift))
                else:
                    ended = AlarmRow.scanner_id == scanner_id, AlarmRow.what == alarm.what
                    session.execute(delete(AlarmRow).where(*ended))
                _announce(session, now, what, alarm)
            return changes


def close_alarms(session: Session, now: datetime, scanner_id: str) -> None:
    """Close those of a scanner that is deleted."""
    for alarm in _opened(session, scanner_id):
        _announce(session, now, mill_events.ALARM_CLOSED, alarm)
    session.execute(delete(AlarmRow).where(AlarmRow.scanner_id == scanner_id))


def _announce(session: Session, now: datetime, what: EventKind, alarm: Alarm) -> None:
    detail = alarm.model_dump(mode="json", exclude={"scanner_id"}, exclude_none=True)
    announce(
        session,
        now,
        what,
        "scanner",
        alarm.scanner_id,
        group_id=alarm.scanner_id,
        detail=detail,
        why=alarm.sentence,
    )


class _Expected(NamedTuple):
    """What an alarm would tell, and from when on it is opened."""

    alarm: Alarm
    opens_at: datetime


class _Known(NamedTuple):
    """Of one scanner: times are of its newest scans, None where there is none.

    A scan that was deleted counts for `scan_at`, and for `phantom_scan_at` where a calibration was made of it.
    `coming_at` is of the newest phantom scan that is read or may yet turn out readable, `ready_at` of the newest
    that is read; its phantom has `phantom_id` and `measurements`.
    """

    scanner: ScannerRow
    scan_at: datetime | None
    phantom_scan_at: datetime | None
    coming_at: datetime | None
    ready_at: datetime | None
    phantom_id: str | None
    measurements: Any


def _changes(session: Session, now: datetime, scanner_id: str | None = None) -> Iterator[AlarmChange]:
    """What has ended, and what is new. The time opens alarms and ends none: clocks differ, and are put back."""
    opened = {(each.scanner_id, each.what): each for each in _opened(session, scanner_id)}
    drifted = _drifted(session, scanner_id)
    for known in _known(session, scanner_id):
        try:
            expected = {each.alarm.what: each for each in _expected(known)}
            if known.scanner.id in drifted:
                expected[AlarmKind.DRIFT] = _of_drift(known.scanner.id, drifted[known.scanner.id])
        except ValidationError as error:
            structlog.get_logger().error("alarms-unreadable", scanner_id=known.scanner.id, reason=str(error))
            continue
        for what in AlarmKind:
            alarm, next_one = opened.get((known.scanner.id, what)), expected.get(what)
            if alarm is not None and (next_one is None or _ended(alarm, next_one.alarm)):
                yield AlarmChange(mill_events.ALARM_CLOSED, alarm)
                alarm = None
            if alarm is None and next_one is not None and next_one.opens_at <= now:
                yield AlarmChange(mill_events.ALARM_OPENED, next_one.alarm)


def _ended(alarm: Alarm, next_one: Alarm) -> bool:
    """Whether a later scan came, or the limit or the phantom is another; not because a scan was deleted."""
    if alarm.last_at is not None and next_one.last_at is not None and next_one.last_at > alarm.last_at:
        return True
    same = {"limit_hours", "phantom_id", "expired_on"}
    return alarm.model_dump(include=same) != next_one.model_dump(include=same)


def _opened(session: Session, scanner_id: str | None) -> list[Alarm]:
    statement = select(AlarmRow).order_by(AlarmRow.scanner_id, AlarmRow.what)
    if scanner_id is not None:
        statement = statement.where(AlarmRow.scanner_id == scanner_id)
    rows = session.scalars(statement)
    return [read_alarm(row) for row in rows]


def read_alarm(row: AlarmRow) -> Alarm:
    """The alarm of a row."""
    return Alarm.model_validate({name: getattr(row, name) for name in Alarm.model_fields})


def _known(session: Session, scanner_id: str | None) -> Iterator[_Known]:
    statement = (
        select(
            ScannerRow,
            _newest(ScanRow.created_at),
            _newest_accepted(),
            _newest(ScanRow.created_at, *_READY),
            _newest_calibrated(),
            _newest(ScanRow.created_at, *_COMING),
            PhantomRow.id,
            PhantomRow.drawing["measurements"],
        )
        .select_from(ScannerRow)
        .outerjoin(PhantomRow, PhantomRow.id == _newest(ScanRow.phantom_id, *_READY))
    )
    if scanner_id is not None:
        statement = statement.where(ScannerRow.id == scanner_id)
    for scanner, stored_at, accepted_at, ready_at, calibrated_at, coming_at, *phantom in session.execute(statement):
        scan_at, phantom_scan_at = _latest(stored_at, accepted_at), _latest(ready_at, calibrated_at)
        yield _Known(scanner, scan_at, phantom_scan_at, coming_at, ready_at, *phantom)


def _drifted(session: Session, scanner_id: str | None) -> dict[str, list[Any]]:
    """By scanner: what charts of its active calibration found. Another calibration ends it."""
    columns = DriftChartRow.scanner_id, DriftChartRow.activation_number, DriftChartRow.alarm
    statement = select(*columns).where(DriftChartRow.alarm.is_not(None))
    if scanner_id is not None:
        statement = statement.where(DriftChartRow.scanner_id == scanner_id)
    found_of = dict[str, list[Any]]()
    for its_id, activation_number, alarm in session.execute(statement):
        active = active_since(session, its_id)
        if active is not None and active.number == activation_number:
            found_of.setdefault(its_id, []).append(alarm)
    return found_of


def _of_drift(scanner_id: str, found: list[Any]) -> _Expected:
    """The first that its charts found."""
    about = {"scanner_id": scanner_id, "what": AlarmKind.DRIFT}
    alarms = [Alarm.model_validate(about | {"since": each.get("at"), "drift": each.get("finding")}) for each in found]
    first = min(alarms, key=lambda each: each.since)
    return _Expected(first, first.since)


def _expected(known: _Known) -> Iterator[_Expected]:
    """Each alarm that the scanner's limits and phantom will open if nothing comes."""
    scanner = known.scanner
    limits = AlarmLimits.model_validate(scanner.spec.get("alarms", {}))
    every_days = limits.phantom_scan_every_days
    for what, newest_at, coming_at, limit_hours in (
        (
            AlarmKind.NO_PHANTOM_SCAN,
            known.phantom_scan_at,
            known.coming_at,
            None if every_days is None else 24.0 * every_days,
        ),
        (AlarmKind.SCANNER_QUIET, known.scan_at, None, limits.quiet_after_hours),
    ):
        if limit_hours is not None:
            last_at, limit = newest_at or scanner.created_at, timedelta(hours=limit_hours)
            alarm = Alarm(
                scanner_id=scanner.id, what=what, since=last_at + limit, last_at=last_at, limit_hours=limit_hours
            )
            yield _Expected(alarm, max(last_at, coming_at or last_at) + limit)
    measured = _MEASUREMENTS.validate_python(known.measurements or [])
    is_coming = known.coming_at != known.ready_at
    if expiring := [each.expires_on for each in measured if each.expires_on]:
        since = datetime.combine(min(expiring) + timedelta(days=1), time(), UTC)
        alarm = Alarm(
            scanner_id=scanner.id,
            what=AlarmKind.PHANTOM_EXPIRED,
            since=since,
            phantom_id=known.phantom_id,
            expired_on=min(expiring),
        )
        yield _Expected(alarm, _NOT_YET if is_coming else since)


def _latest(*times: datetime | None) -> datetime | None:
    return max((each for each in times if each is not None), default=None)


def _newest(column: InstrumentedAttribute[Any], *conditions: ColumnElement[bool]) -> ScalarSelect[Any]:
    """Of the scanner's newest scan of which the conditions are true."""
    mine = select(column).where(ScanRow.scanner_id == ScannerRow.id, *conditions)
    return mine.order_by(ScanRow.created_at.desc()).limit(1).correlate(ScannerRow).scalar_subquery()


def _newest_accepted() -> ScalarSelect[Any]:
    """When the newest scan came, whether it is stored still or not: events outlast scans."""
    came = EventRow.group_id == ScannerRow.id, EventRow.what == event_kinds.QUEUED, EventRow.subject == "scan"
    mine = select(EventRow.at).where(*came).order_by(EventRow.number.desc())
    return mine.limit(1).correlate(ScannerRow).scalar_subquery()


def _newest_calibrated() -> ScalarSelect[Any]:
    """When the newest scan came of which a calibration was made: this and the job that read it outlast the scan."""
    read = select(func.max(JobRow.created_at)).join(CalibrationRow, CalibrationRow.scan_id == JobRow.subject_id)
    mine = read.where(CalibrationRow.scanner_id == ScannerRow.id, JobRow.kind == job_kinds.INGEST)
    return mine.correlate(ScannerRow).scalar_subquery()
