"""The alarms of a scanner: when each one opens and closes, and its words."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from sawmill_contracts import mill_events
from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.scanner_drift import DriftFinding
from sawmill_contracts.scanners import AlarmLimits
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_vocabulary.messages import N_, Message

SHIFT_ENDS = (6, 14, 22)  # hours
_NOT_YET = datetime.max.replace(tzinfo=UTC)
# Another value of one of these makes an alarm another alarm.
_REASONS = ("limit_hours", "phantom_id", "expired_on")


class ChartAlarm(NamedTuple):
    """A jump or a trend that a drift chart has found."""

    at: datetime
    finding: DriftFinding


@dataclass(frozen=True)
class ScannerFacts:
    """The facts about one scanner that its alarms depend on; a time is None where there is no such scan."""

    scanner_id: str
    added_at: datetime
    limits: AlarmLimits
    # When the newest stored scan came, and the newest of all, of which a deleted one is known by its event.
    scan_stored_at: datetime | None = None
    scan_accepted_at: datetime | None = None
    # The same of phantom scans that are read, a deleted one if a calibration was made of it.
    phantom_ready_at: datetime | None = None
    phantom_calibrated_at: datetime | None = None
    # When the newest phantom scan came that is read or may yet turn out readable.
    phantom_coming_at: datetime | None = None
    # The phantom in the newest stored phantom scan that is read, and the last days of validity of the measurements.
    phantom_id: str | None = None
    expiry_days: tuple[date, ...] = ()
    # Found since the active calibration: another calibration ends them.
    chart_alarms: tuple[ChartAlarm, ...] = ()
    # Until when somebody knows why the scanner is red, so that its drift is no news; None: nobody does.
    known_until: datetime | None = None


class ExpectedAlarm(NamedTuple):
    """An alarm, and the time at which it opens if nothing comes before."""

    alarm: Alarm
    opens_at: datetime


class AlarmMessage(Message):
    """Messages of the alarms on pages."""

    NO_PHANTOM_SCAN = (
        "no-phantom-scan",
        N_("No phantom was scanned for longer than is allowed."),
        N_("Scan one, and calibrate."),
    )
    PHANTOM_EXPIRED = (
        "phantom-expired",
        N_("The measurement of its phantom has expired."),
        N_("Measure the phantom again."),
    )
    SCANNER_QUIET = (
        "scanner-quiet",
        N_("It has sent no scan for longer than is allowed."),
        N_("Look at the scanner and its network."),
    )
    DRIFT = "drift", N_("The scans of its logs together show that it has moved."), N_("Scan the phantom and calibrate.")


@dataclass(frozen=True)
class AlarmRule:
    """The declaration of an alarm.

    `expected` returns the alarm that opens if nothing comes, None where the scanner has no such alarm. Pages show the
    `message`, events the `sentence`, in English. `fields` are the fields of `Alarm` that this one has.
    """

    expected: Callable[[ScannerFacts], ExpectedAlarm | None]
    message: AlarmMessage
    sentence: Callable[[Alarm], str]
    fields: tuple[str, ...]


class AlarmChange(NamedTuple):
    """An alarm that was opened, or that has ended."""

    type: EventType
    alarm: Alarm


def alarm_changes(facts: ScannerFacts, open_alarms: Mapping[AlarmKind, Alarm], now: datetime) -> Iterator[AlarmChange]:
    """Yield the alarms of a scanner that have ended and those that open now.

    The time opens alarms and ends none: clocks differ, and are put back.
    """
    for what, rule in ALARMS.items():
        alarm, expected = open_alarms.get(what), rule.expected(facts)
        if alarm is not None and (expected is None or _has_ended(alarm, expected.alarm)):
            yield AlarmChange(mill_events.ALARM_CLOSED, alarm)
            alarm = None
        if alarm is None and expected is not None and expected.opens_at <= now:
            yield AlarmChange(mill_events.ALARM_OPENED, expected.alarm)


def alarm_sentence(alarm: Alarm) -> str:
    """Return what is missing or was seen, in English."""
    return ALARMS[alarm.kind].sentence(alarm)


def is_acknowledged(alarm: Alarm, now: datetime) -> bool:
    """Return whether somebody has taken notice of an alarm until later than now."""
    return alarm.acknowledged is not None and now < alarm.acknowledged.until


def shift_end(now: datetime) -> datetime:
    """Return the end of the shift of a sawmill that works in three, in the time zone of `now`."""
    ends = (now.replace(hour=hour, minute=0, second=0, microsecond=0) for hour in SHIFT_ENDS)
    return min(end if end > now else end + timedelta(days=1) for end in ends)


def _has_ended(alarm: Alarm, expected: Alarm) -> bool:
    """Return whether a later scan came, or the limit or the phantom changed; a deleted scan ends no alarm."""
    if alarm.last_at is not None and expected.last_at is not None and expected.last_at > alarm.last_at:
        return True
    return any(getattr(alarm, name) != getattr(expected, name) for name in _REASONS)


def _no_phantom_scan(facts: ScannerFacts) -> ExpectedAlarm | None:
    """Expect a phantom scan that is read; one that is being read puts the alarm off."""
    days = facts.limits.phantom_scan_every_days
    if days is None:
        return None
    last_at = _latest(facts.phantom_ready_at, facts.phantom_calibrated_at) or facts.added_at
    return _absence(facts, AlarmKind.NO_PHANTOM_SCAN, last_at, 24.0 * days, facts.phantom_coming_at)


def _scanner_quiet(facts: ScannerFacts) -> ExpectedAlarm | None:
    limit_hours = facts.limits.quiet_after_hours
    if limit_hours is None:
        return None
    last_at = _latest(facts.scan_stored_at, facts.scan_accepted_at) or facts.added_at
    return _absence(facts, AlarmKind.SCANNER_QUIET, last_at, limit_hours)


def _absence(
    facts: ScannerFacts, what: AlarmKind, last_at: datetime, limit_hours: float, coming_at: datetime | None = None
) -> ExpectedAlarm:
    limit, id_ = timedelta(hours=limit_hours), facts.scanner_id
    alarm = Alarm(scanner_id=id_, kind=what, since=last_at + limit, last_at=last_at, limit_hours=limit_hours)
    return ExpectedAlarm(alarm, max(last_at, coming_at or last_at) + limit)


def _phantom_expired(facts: ScannerFacts) -> ExpectedAlarm | None:
    """Expect that the measurements stay valid; a phantom scan that is being read puts the alarm off."""
    if not facts.expiry_days:
        return None
    last_day, is_coming = min(facts.expiry_days), facts.phantom_coming_at != facts.phantom_ready_at
    since = datetime.combine(last_day + timedelta(days=1), time(), UTC)
    about = {"phantom_id": facts.phantom_id, "expired_on": last_day}
    alarm = Alarm(scanner_id=facts.scanner_id, kind=AlarmKind.PHANTOM_EXPIRED, since=since, **about)
    return ExpectedAlarm(alarm, _NOT_YET if is_coming else since)


def _drift(facts: ScannerFacts) -> ExpectedAlarm | None:
    """Expect no change in the charts; the first one that was found opens the alarm, once no red is known."""
    if not facts.chart_alarms:
        return None
    since, finding = min(facts.chart_alarms, key=lambda each: each.at)
    alarm = Alarm(scanner_id=facts.scanner_id, kind=AlarmKind.DRIFT, since=since, drift=finding)
    return ExpectedAlarm(alarm, max(since, facts.known_until or since))


def _latest(*times: datetime | None) -> datetime | None:
    return max((each for each in times if each is not None), default=None)


def _came_not(scan: str, alarm: Alarm) -> str:
    since = "" if alarm.last_at is None else f" after {alarm.last_at:%Y-%m-%d %H:%M} UTC"
    return f"no {scan} came{since} for {alarm.limit_hours:g} hours"


# All alarms, in the order in which they are checked.
ALARMS: Mapping[AlarmKind, AlarmRule] = MappingProxyType(
    {
        AlarmKind.NO_PHANTOM_SCAN: AlarmRule(
            _no_phantom_scan,
            AlarmMessage.NO_PHANTOM_SCAN,
            partial(_came_not, "scan of a phantom"),
            ("last_at", "limit_hours"),
        ),
        AlarmKind.PHANTOM_EXPIRED: AlarmRule(
            _phantom_expired,
            AlarmMessage.PHANTOM_EXPIRED,
            lambda alarm: f"the measurement of the phantom {alarm.phantom_id} was good until {alarm.expired_on}",
            ("phantom_id", "expired_on"),
        ),
        AlarmKind.SCANNER_QUIET: AlarmRule(
            _scanner_quiet, AlarmMessage.SCANNER_QUIET, partial(_came_not, "scan"), ("last_at", "limit_hours")
        ),
        AlarmKind.DRIFT: AlarmRule(
            _drift, AlarmMessage.DRIFT, lambda alarm: "" if alarm.drift is None else alarm.drift.sentence, ("drift",)
        ),
    }
)
