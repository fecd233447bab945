"""Alarms of absence: each opens once and ends once, whoever looks, after a restart as well."""

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, date, datetime, timedelta

import pytest

from sawmill_worker.contracts.phantoms import PhantomDrawing, SizeMeasurement
from sawmill_worker.contracts.scanners import AlarmLimits
from sawmill_worker.contracts.scans import ScanSpec
from sawmill_worker.storage.store import Store
from sawmill_worker.vocabulary import DataKind, Disc

START = datetime(2026, 3, 2, 5, 0, tzinfo=UTC)


@pytest.fixture
def store(clocked_store):
    return clocked_store


@pytest.fixture
def limited(store, scanner):
    """Set the scanner's limits."""

    def limit(**limits):
        known = store.scanners.get(scanner.id)
        return store.scanners.update(scanner.id, known.model_copy(update={"alarms": AlarmLimits(**limits)}))

    return limit


@pytest.fixture
def log(store, scanner):
    """Accept a scan without a phantom."""

    def accept():
        spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
        return store.scans.accept(spec, store.files.receive([b"log"], max_bytes=10))

    return accept


def events_of(store):
    """The events of alarms, the oldest first."""
    events = [event for event in store.events.following(0) if event.what.startswith("alarm")]
    return [(event.what.removeprefix("alarm-"), event.detail["what"]) for event in events]


def test_a_scanner_that_falls_silent_opens_one_alarm_until_it_sends_again(store, scanner, limited, log, clock):
    limited(quiet_after_hours=24)
    log()
    clock.advance(hours=23)
    assert store.alarms.check() == []
    clock.advance(hours=1)
    ((what, alarm),) = store.alarms.check()
    assert (what, alarm.what, alarm.since) == ("alarm-opened", "scanner-quiet", START + timedelta(hours=24))
    assert (alarm.last_at, alarm.limit_hours, alarm.scanner_id) == (START, 24.0, scanner.id)
    clock.advance(hours=30)
    assert store.alarms.check() == []
    assert store.alarms.open(scanner_id=scanner.id) == store.alarms.open() == [alarm]
    log()
    assert [(what.value, ended) for what, ended in store.alarms.check()] == [("alarm-closed", alarm)]
    assert store.alarms.open() == store.alarms.check() == []
    assert events_of(store) == [("opened", "scanner-quiet"), ("closed", "scanner-quiet")]


@pytest.mark.usefixtures("ready_scan")
def test_logs_do_not_stand_in_for_a_phantom(store, limited, log, upload, clock):
    limited(phantom_scan_every_days=14, quiet_after_hours=400)
    clock.advance(days=13)
    log()
    assert store.alarms.check() == []
    clock.advance(days=1)
    ((_, alarm),) = store.alarms.check()
    assert (alarm.what, alarm.last_at, alarm.limit_hours) == ("no-phantom-scan", START, 336.0)
    upload(store)
    assert [what.value for what, _ in store.alarms.check()] == ["alarm-closed"]


def test_without_a_scan_the_time_counts_from_the_scanner_and_without_a_limit_there_is_no_alarm(store, limited, clock):
    clock.advance(days=300)
    assert store.alarms.check() == []
    limited(quiet_after_hours=24, phantom_scan_every_days=7)
    assert {alarm.last_at for _, alarm in store.alarms.check()} == {START}
    # Another limit is another alarm; none ends it.
    limited(quiet_after_hours=48, phantom_scan_every_days=7)
    assert [what.value for what, _ in store.alarms.check()] == ["alarm-closed", "alarm-opened"]
    limited()
    assert [what.value for what, _ in store.alarms.check()] == ["alarm-closed", "alarm-closed"]


def test_a_phantom_whose_measurement_expired_is_named_until_another_one_is_scanned(store, upload, clock):
    def phantom(expires_on):
        measured = [
            SizeMeasurement(what=axis, measured_mm=100, standard_uncertainty_mm=0.1, expires_on=expires_on)
            for axis in "xy"
        ]
        drawing = PhantomDrawing(name="disc", shapes=[Disc(center_mm=(0, 0), radius_mm=50)], measurements=measured)
        return store.phantoms.create(drawing).id

    old, new = phantom(date(2026, 3, 3)), phantom(date(2028, 3, 3))
    upload(store, phantom_id=old)
    clock.advance(hours=42)  # 3 March, the last day
    assert store.alarms.check() == []
    clock.advance(hours=1)
    ((_, alarm),) = store.alarms.check()
    assert (alarm.what, alarm.phantom_id, alarm.expired_on) == ("phantom-expired", old, date(2026, 3, 3))
    assert alarm.since == datetime(2026, 3, 4, tzinfo=UTC)
    upload(store, phantom_id=new)
    assert [what.value for what, _ in store.alarms.check()] == ["alarm-closed"]


def test_several_schedulers_open_and_close_each_alarm_once_over_a_year(store, scanner, limited, log, clock):
    """A log every Monday, silence from Tuesday on; the service is started anew each week."""
    limited(quiet_after_hours=24, phantom_scan_every_days=30)
    with ThreadPoolExecutor(3) as pool:
        for _ in range(52):
            log()
            for days in (0, 2, 5):
                clock.advance(days=days)
                others = [Store(store.settings, clock=clock) for _ in range(2)]
                list(pool.map(lambda each: each.alarms.check(), (store, *others)))
                for other in others:
                    other.close()
    quiet = [what for what, of in events_of(store) if of == "scanner-quiet"]
    assert quiet == ["opened", "closed"] * 51 + ["opened"]
    assert [what for what, of in events_of(store) if of == "no-phantom-scan"] == ["opened"]
    assert [alarm.what for alarm in store.alarms.open(scanner_id=scanner.id)] == ["no-phantom-scan", "scanner-quiet"]


def test_alarms_go_with_their_scanner(store, scanner, limited, clock):
    limited(quiet_after_hours=1)
    clock.advance(hours=2)
    store.alarms.check()
    store.scanners.delete(scanner.id)
    assert store.alarms.open() == store.alarms.check() == []
