"""When alarms open and close, on plain facts."""

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta

import pytest

from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.scanner_drift import DriftFinding
from sawmill_contracts.scanners import AlarmLimits
from sawmill_mill.alarms import ALARMS, ChartAlarm, ScannerFacts, alarm_changes, alarm_sentence, shift_end

START = datetime(2026, 3, 2, 5, 0, tzinfo=UTC)
NEW = ScannerFacts(scanner_id="line", added_at=START, limits=AlarmLimits())
QUIET = replace(NEW, limits=AlarmLimits(quiet_after_hours=24))
PHANTOM = replace(NEW, limits=AlarmLimits(phantom_scan_every_days=1))
JUMP = DriftFinding(kind="jump", evidence=61.0, limit=40.0, scatter=1.0)


def hours(number):
    return START + timedelta(hours=number)


def after(facts, now, opened=()):
    alarms = dict(opened)
    for what, alarm in alarm_changes(facts, alarms, now):
        if what == "alarm-opened":
            alarms[alarm.kind] = alarm
        else:
            assert alarms.pop(alarm.kind) == alarm
    return alarms


def test_nothing_opens_without_limits_and_without_a_scan_the_time_counts_from_the_scanner():
    assert after(NEW, START + timedelta(days=300)) == {}
    facts = replace(NEW, limits=AlarmLimits(quiet_after_hours=24, phantom_scan_every_days=1))
    assert after(facts, hours(23)) == {}
    assert {what: (alarm.last_at, alarm.since) for what, alarm in after(facts, hours(24)).items()} == {
        AlarmKind.NO_PHANTOM_SCAN: (START, hours(24)),
        AlarmKind.SCANNER_QUIET: (START, hours(24)),
    }


def test_another_limit_is_another_alarm_no_limit_ends_it_and_no_clock_and_no_deletion_closes_it():
    longer = after(replace(QUIET, limits=AlarmLimits(quiet_after_hours=48)), hours(100), after(QUIET, hours(100)))
    assert [alarm.limit_hours for alarm in longer.values()] == [48.0]
    assert after(NEW, hours(100), longer) == {}
    heard = replace(QUIET, scan_stored_at=hours(2))
    opened = after(heard, hours(26))
    assert opened
    assert after(heard, hours(1), opened) == after(QUIET, hours(26), opened) == opened
    for time in ("scan_stored_at", "scan_accepted_at"):  # a deleted scan counts
        assert after(replace(QUIET, **{time: hours(30)}), hours(30), opened) == {}


def test_a_phantom_scan_that_is_being_read_puts_the_alarm_off_and_ends_none():
    reading = replace(PHANTOM, phantom_coming_at=hours(23))
    assert after(reading, hours(25)) == {}
    opened = after(PHANTOM, hours(25))
    assert after(reading, hours(25), opened) == opened
    for read in ({"phantom_ready_at": hours(23)}, {"phantom_calibrated_at": hours(23)}):
        assert after(replace(reading, **read), hours(25), opened) == {}


def test_a_measurement_is_good_to_the_end_of_its_last_day():
    facts = replace(NEW, phantom_id="disc", expiry_days=(date(2026, 3, 9), date(2026, 3, 3)))
    midnight = datetime(2026, 3, 4, tzinfo=UTC)
    assert after(facts, midnight - timedelta(seconds=1)) == {}
    opened = after(facts, midnight)
    alarm = opened[AlarmKind.PHANTOM_EXPIRED]
    assert (alarm.phantom_id, alarm.expired_on, alarm.since) == ("disc", date(2026, 3, 3), midnight)
    assert after(replace(facts, phantom_coming_at=midnight), midnight) == {}, "another phantom may be in the scan"
    assert after(replace(facts, phantom_coming_at=midnight), midnight, opened) == opened
    assert after(replace(facts, expiry_days=(date(2026, 3, 9),)), midnight, opened) == {}


def test_the_first_finding_opens_the_alarm_of_drift_until_another_calibration_is_active():
    facts = replace(NEW, chart_alarms=(ChartAlarm(hours(5), JUMP), ChartAlarm(hours(4), JUMP)))
    opened = after(facts, hours(5))
    assert opened[AlarmKind.DRIFT].since == hours(4)
    assert after(facts, hours(6), opened) == opened
    assert after(NEW, hours(6), opened) == {}


def test_each_alarm_has_its_fields_and_its_words():
    facts = replace(NEW, chart_alarms=(ChartAlarm(START, JUMP),), expiry_days=(START.date(),))
    facts = replace(facts, phantom_id="disc", limits=AlarmLimits(quiet_after_hours=24, phantom_scan_every_days=1))
    opened = after(facts, hours(100))
    assert opened.keys() == ALARMS.keys() == set(AlarmKind)
    optional = {name for name, field in Alarm.model_fields.items() if not field.is_required()}
    for what, alarm in opened.items():
        assert {name for name in optional if getattr(alarm, name) is not None} == set(ALARMS[what].fields)
        assert ALARMS[what].message().endswith(".")
    assert {what.value: alarm_sentence(alarm) for what, alarm in opened.items()} == {
        "no-phantom-scan": "no scan of a phantom came after 2026-03-02 05:00 UTC for 24 hours",
        "phantom-expired": "the measurement of the phantom disc was good until 2026-03-02",
        "scanner-quiet": "no scan came after 2026-03-02 05:00 UTC for 24 hours",
        "drift": "the logs show no change of the geometry",
    }


@pytest.mark.parametrize(("hour", "end"), [(5, 6), (6, 14), (13, 14), (14, 22), (22, 30), (23, 30)])
def test_a_shift_ends_at_six_two_and_ten(hour, end):
    begun = datetime(2026, 3, 2, hour, 20 if hour in {5, 13, 23} else 0, tzinfo=UTC)
    assert shift_end(begun) == datetime(2026, 3, 2, tzinfo=UTC) + timedelta(hours=end)
