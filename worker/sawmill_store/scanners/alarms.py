"""Alarms by the rules of `sawmill_mill.alarms`. A row is an open alarm: written when it opens, removed when it ends."""

from collections import defaultdict
from collections.abc import Collection, Iterator
from datetime import datetime, timedelta
from typing import Any

import structlog
from pydantic import TypeAdapter, ValidationError
from sqlalchemy import ColumnElement, ScalarSelect, Select, delete, func, select, true
from sqlalchemy.orm import InstrumentedAttribute, Session

from sawmill_contracts import kinds, mill_events
from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.next_steps import Acknowledgement, KnownRed
from sawmill_contracts.phantoms import SizeMeasurement
from sawmill_contracts.scanners import AlarmLimits
from sawmill_contracts.scans import ScanState
from sawmill_mill.alarms import AlarmChange, ChartAlarm, ScannerFacts, alarm_changes, alarm_sentence
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.paging import found
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_platform.errors import Conflict, Invalid, NotFound
from sawmill_platform.ledger.events import actor, announce
from sawmill_store.activations import active_since
from sawmill_store.mill_tables import (
    ActivationRow,
    AlarmRow,
    CalibrationRow,
    DriftChartRow,
    PhantomRow,
    ScannerRow,
    ScanRow,
)

LONGEST_NOTICE = timedelta(days=31)
_READY = (ScanRow.phantom_id.is_not(None), ScanRow.state == ScanState.READY)
_COMING = (ScanRow.phantom_id.is_not(None), ScanRow.state != ScanState.REFUSED)
_MEASUREMENTS = TypeAdapter(list[SizeMeasurement])
_CHART_ALARMS = TypeAdapter(tuple[ChartAlarm, ...])


class Alarms(StorePart):
    """Store of alarms; `check` is one transaction for each scanner whose alarms change."""

    def open(self, *, scanner_id: str | None = None) -> list[Alarm]:
        """Return the open alarms, of all scanners or of one."""
        with self._database.read() as session:
            return _opened(session, scanner_id)

    def check(self) -> list[AlarmChange]:
        """Open the alarms that are due and close the alarms that have ended, once each, however many processes check.

        A scanner whose limits or whose phantom's measurements cannot be read is logged and left as it is.
        """
        with self._database.read() as session:
            changing = {change.alarm.scanner_id for change in _changes(session, self._database.now())}
        return [change for scanner_id in sorted(changing) for change in self._bring_up_to_date(scanner_id)]

    def acknowledge(self, scanner_id: str, kind: AlarmKind, until: datetime, reason: str) -> Alarm:
        """Take notice of an open alarm until a time.

        Raises
        ------
        NotFound, Invalid
            There is no such open alarm; the time has passed.
        """
        with self._database.write() as session:
            row = session.get(AlarmRow, (scanner_id, kind), with_for_update=True)
            if row is None:
                raise NotFound("alarm", f"{kind} of scanner {scanner_id}")
            now = self._database.now()
            notice = Acknowledgement(until=_ahead(until, now), by=actor().name, reason=reason).model_dump(mode="json")
            row.acknowledged = notice
            detail = {"kind": kind, "until": notice["until"], "reason": reason}
            acknowledged, decided = mill_events.ALARM_ACKNOWLEDGED, {"scanner_id": scanner_id, **detail}
            announce(
                session, now, acknowledged, "scanner", scanner_id, group_id=scanner_id, detail=detail, decided=decided
            )
            return Alarm.of_row(row)

    def acknowledge_red(self, scanner_id: str, results: Collection[str], until: datetime, reason: str) -> KnownRed:
        """Take notice until a time of the results that show a scanner red.

        Raises
        ------
        NotFound, Conflict, Invalid
            There is no such scanner; no result shows it red; the time has passed, or lies too far ahead.
        """
        with self._database.write() as session:
            found(session, ScannerRow, "scanner", scanner_id, lock=True)
            if not results:
                raise Conflict("scanner-not-red", f"no result shows scanner {scanner_id!r} red")
            now = self._database.now()
            if until - now > LONGEST_NOTICE:
                raise Invalid("invalid-request", f"until must be within {LONGEST_NOTICE.days} days, not {until}")
            known = KnownRed(until=_ahead(until, now), by=actor().name, reason=reason, results=frozenset(results))
            detail = known.model_dump(mode="json", exclude={"by"})
            kind, decided = mill_events.RED_ACKNOWLEDGED, {"scanner_id": scanner_id, **detail}
            announce(session, now, kind, "scanner", scanner_id, group_id=scanner_id, detail=detail, decided=decided)
            return known

    def known_reds(self) -> dict[str, KnownRed]:
        """Return the newest notice of a red scanner by scanner, as far as the notices have not ended."""
        with self._database.read() as session:
            return _known_reds(session, self._database.now())

    def _bring_up_to_date(self, scanner_id: str) -> list[AlarmChange]:
        with self._database.write() as session:
            # The lock makes a second process wait, which then finds the alarms that the first has written.
            session.execute(select(ScannerRow.id).where(ScannerRow.id == scanner_id).with_for_update())
            now = self._database.now()
            changes = list(_changes(session, now, scanner_id))
            for what, alarm in changes:
                if what is mill_events.ALARM_OPENED:
                    drift = None if alarm.drift is None else alarm.drift.model_dump(mode="json")
                    session.add(AlarmRow(**alarm.model_dump(exclude={"drift", "acknowledged"}), drift=drift))
                else:
                    ended = AlarmRow.scanner_id == scanner_id, AlarmRow.kind == alarm.kind
                    session.execute(delete(AlarmRow).where(*ended))
                _announce(session, now, what, alarm)
            return changes


def _ahead(until: datetime, now: datetime) -> datetime:
    if until <= now:
        raise Invalid("acknowledgement-ended", f"until must lie ahead, and {until.isoformat()} has passed")
    return until


def _known_reds(session: Session, now: datetime) -> dict[str, KnownRed]:
    """Read the newest notices; the next acceptance of a calibration ends one too."""
    of_reds = EventRow.type == mill_events.RED_ACKNOWLEDGED
    newest = select(func.max(EventRow.number)).where(of_reds).group_by(EventRow.group_id)
    accepted = select(ActivationRow.number).where(
        ActivationRow.scanner_id == EventRow.group_id, ActivationRow.activated_at > EventRow.at
    )
    rows = session.scalars(select(EventRow).where(EventRow.number.in_(newest), ~accepted.exists()))
    notices = {row.group_id or "": KnownRed.model_validate({**(row.detail or {}), "by": row.who}) for row in rows}
    return {scanner_id: notice for scanner_id, notice in notices.items() if notice.until > now}


def close_alarms(session: Session, now: datetime, scanner_id: str) -> None:
    """Close the alarms of a scanner that is deleted."""
    for alarm in _opened(session, scanner_id):
        _announce(session, now, mill_events.ALARM_CLOSED, alarm)
    session.execute(delete(AlarmRow).where(AlarmRow.scanner_id == scanner_id))


def _announce(session: Session, now: datetime, what: EventType, alarm: Alarm) -> None:
    announce(
        session,
        now,
        what,
        "scanner",
        alarm.scanner_id,
        group_id=alarm.scanner_id,
        detail=alarm.model_dump(mode="json", exclude={"scanner_id", "acknowledged"}, exclude_none=True),
        why=alarm_sentence(alarm),
    )


def _changes(session: Session, now: datetime, scanner_id: str | None = None) -> Iterator[AlarmChange]:
    """Yield the changes of one scanner or of all, by the rules of `sawmill_mill.alarms`."""
    opened = defaultdict[str, dict[AlarmKind, Alarm]](dict)
    for alarm in _opened(session, scanner_id):
        opened[alarm.scanner_id][alarm.kind] = alarm
    # By scanner what the charts since its active calibration have found.
    columns = DriftChartRow.scanner_id, DriftChartRow.activation_number, DriftChartRow.alarm
    of_scanner = true() if scanner_id is None else DriftChartRow.scanner_id == scanner_id
    chart_alarms = defaultdict[str, list[Any]](list)
    for chart in session.execute(select(*columns).where(DriftChartRow.alarm.is_not(None), of_scanner)):
        active = active_since(session, chart.scanner_id)
        if active is not None and active.number == chart.activation_number:
            chart_alarms[chart.scanner_id].append(chart.alarm)
    known = _known_reds(session, now)
    for row in session.execute(_of_scanners(scanner_id)).mappings():
        try:
            notice = known.get(row["scanner_id"])
            measurements = _MEASUREMENTS.validate_python(row["measurements"] or [])
            read = {
                "limits": AlarmLimits.model_validate(row["spec"].get("alarms", {})),
                "expiry_days": tuple(each.expires_on for each in measurements if each.expires_on is not None),
                "chart_alarms": _CHART_ALARMS.validate_python(chart_alarms[row["scanner_id"]]),
                "known_until": None if notice is None else notice.until,
            }
            facts = ScannerFacts(
                **{name: value for name, value in row.items() if name not in {"spec", "measurements"}} | read
            )
        except ValidationError as error:
            structlog.get_logger().error("alarms-unreadable", scanner_id=row["scanner_id"], reason=str(error))
            continue
        yield from alarm_changes(facts, opened[facts.scanner_id], now)


def _opened(session: Session, scanner_id: str | None) -> list[Alarm]:
    of_scanner = true() if scanner_id is None else AlarmRow.scanner_id == scanner_id
    statement = select(AlarmRow).where(of_scanner).order_by(AlarmRow.scanner_id, AlarmRow.kind)
    return [Alarm.of_row(row) for row in session.scalars(statement)]


def _of_scanners(scanner_id: str | None) -> Select[Any]:
    """Select the facts of scanners; events and jobs keep the times of deleted scans."""
    # The newest calibrated scan: its calibration and the job that read the scan outlast it.
    read = select(func.max(JobRow.created_at)).join(CalibrationRow, CalibrationRow.scan_id == JobRow.subject_id)
    mine = read.where(CalibrationRow.scanner_id == ScannerRow.id, JobRow.kind == kinds.INGEST)
    statement = (
        select(
            ScannerRow.id.label("scanner_id"),
            ScannerRow.created_at.label("added_at"),
            ScannerRow.spec,
            _newest(ScanRow.created_at).label("scan_stored_at"),
            newest_accepted(EventRow.at).correlate(ScannerRow).scalar_subquery().label("scan_accepted_at"),
            _newest(ScanRow.created_at, *_READY).label("phantom_ready_at"),
            mine.correlate(ScannerRow).scalar_subquery().label("phantom_calibrated_at"),
            _newest(ScanRow.created_at, *_COMING).label("phantom_coming_at"),
            PhantomRow.id.label("phantom_id"),
            PhantomRow.drawing["measurements"].label("measurements"),
        )
        .select_from(ScannerRow)
        .outerjoin(PhantomRow, PhantomRow.id == _newest(ScanRow.phantom_id, *_READY))
    )
    return statement if scanner_id is None else statement.where(ScannerRow.id == scanner_id)


def _newest(column: InstrumentedAttribute[Any], *conditions: ColumnElement[bool]) -> ScalarSelect[Any]:
    """Select a column of the scanner's newest scan of which the conditions are true."""
    mine = select(column).where(ScanRow.scanner_id == ScannerRow.id, *conditions)
    return mine.order_by(ScanRow.created_at.desc()).limit(1).correlate(ScannerRow).scalar_subquery()


def newest_accepted(column: InstrumentedAttribute[Any]) -> Select[Any]:
    """Select a column of the event of a scanner's newest scan, whether it is still stored or not: events outlast scans.

    Retention keeps the event, so that an alarm knows by it when the last scan came.
    """
    came = EventRow.group_id == ScannerRow.id, EventRow.type == event_kinds.QUEUED, EventRow.subject == "scan"
    return select(column).where(*came).order_by(EventRow.number.desc()).limit(1)
