"""Alarms of absence: each opens once and ends once, whoever looks, after a restart as well."""

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, date, datetime, timedelta

import pytest
from sqlalchemy import update
from structlog.testing import capture_logs

from sawmill_contracts.alarms import Alarm
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.phantoms import PhantomDrawing, SizeMeasurement
from sawmill_contracts.scanners import AlarmLimits
from sawmill_store.mill_tables import PhantomRow, ScannerRow
from sawmill_store.store import Store
from sawmill_vocabulary import Disc

pytestmark = pytest.mark.clocked

START = datetime(2026, 3, 2, 5, 0, tzinfo=UTC)


def limited(store, scanner, **limits):
    known = store.scanners.get(scanner.id)
    return store.scanners.update(scanner.id, known.model_copy(update={"alarms": AlarmLimits(**limits)}))


def phantom(store, expires_on):
    """Create a phantom whose measurement is good until a day."""
    size = {"measured_mm": 100, "standard_uncertainty_mm": 0.1, "expires_on": expires_on}
    measured = [SizeMeasurement(dimension=axis, **size) for axis in "xy"]
    drawing = PhantomDrawing(name="disc", shapes=[Disc(center_mm=(0, 0), radius_mm=50)], measurements=measured)
    return store.phantoms.create(drawing).id


def events_of(store):
    events = [event for event in store.events.following(0) if event.type.startswith("alarm")]
    return [(event.type.removeprefix("alarm-"), event.detail["kind"]) for event in events]


def test_a_scanner_that_falls_silent_opens_one_alarm_until_it_sends_again(store, scanner, upload, clock):
    limited(store, scanner, quiet_after_hours=24)
    upload(store, phantom_id=None)
    clock.advance(hours=23)
    assert store.alarms.check() == []
    clock.advance(hours=1)
    ((what, alarm),) = store.alarms.check()
    assert (what, alarm.kind, alarm.since) == ("alarm-opened", "scanner-quiet", START + timedelta(hours=24))
    assert (alarm.last_at, alarm.limit_hours, alarm.scanner_id) == (START, 24.0, scanner.id)
    clock.advance(hours=30)
    assert store.alarms.check() == []
    assert store.alarms.open(scanner_id=scanner.id) == store.alarms.open() == [alarm]
    upload(store, phantom_id=None)
    assert [(what, ended) for what, ended in store.alarms.check()] == [("alarm-closed", alarm)]
    assert store.alarms.open() == store.alarms.check() == []
    assert events_of(store) == [("opened", "scanner-quiet"), ("closed", "scanner-quiet")]


def test_a_phantom_whose_measurement_expired_is_named_until_another_one_is_scanned(
    store, upload, finish, refuse, clock
):
    old, new = phantom(store, date(2026, 3, 3)), phantom(store, date(2028, 3, 3))
    upload(store, phantom_id=old)
    finish(store)
    clock.advance(hours=42)  # 3 March, the last day
    assert store.alarms.check() == []
    clock.advance(hours=1)
    ((_, alarm),) = store.alarms.check()
    assert (alarm.kind, alarm.phantom_id, alarm.expired_on) == ("phantom-expired", old, date(2026, 3, 3))
    assert alarm.since == datetime(2026, 3, 4, tzinfo=UTC)
    upload(store, phantom_id=new)
    assert store.alarms.check() == []
    refuse()
    assert store.alarms.check() == []
    upload(store, phantom_id=new)
    finish(store)
    assert [what for what, _ in store.alarms.check()] == ["alarm-closed"]


@pytest.mark.slow
@pytest.mark.dialect
def test_several_schedulers_open_and_close_each_alarm_once_over_a_quarter(store, scanner, upload, clock):
    """A log every Monday, silence from Tuesday on; two services are started anew each month."""
    limited(store, scanner, quiet_after_hours=24, phantom_scan_every_days=30)
    with ThreadPoolExecutor(3) as pool:
        for _ in range(3):
            others = [Store(store.settings, clock=clock) for _ in range(2)]
            for _ in range(4):
                upload(store, phantom_id=None)
                for days in (0, 2):
                    clock.advance(days=days)
                    list(pool.map(lambda each: each.alarms.check(), (store, *others)))
                clock.advance(days=5)
            for other in others:
                other.close()
    assert [what for what, of in events_of(store) if of == "scanner-quiet"] == ["opened", "closed"] * 11 + ["opened"]
    assert [what for what, of in events_of(store) if of == "no-phantom-scan"] == ["opened"]
    assert [alarm.kind for alarm in store.alarms.open(scanner_id=scanner.id)] == ["no-phantom-scan", "scanner-quiet"]


@pytest.mark.dialect
def test_alarms_go_with_their_scanner(store, scanner, clock):
    limited(store, scanner, quiet_after_hours=1)
    clock.advance(hours=2)
    store.alarms.check()
    store.scanners.delete(scanner.id)
    assert store.alarms.open() == store.alarms.check() == []
    assert events_of(store) == [("opened", "scanner-quiet"), ("closed", "scanner-quiet")]


def test_a_phantom_scan_that_is_refused_ends_no_alarm_and_delays_a_new_one(
    store, scanner, upload, finish, refuse, clock
):
    limited(store, scanner, phantom_scan_every_days=1)
    clock.advance(hours=23)
    upload(store)
    clock.advance(hours=2)
    assert store.alarms.check() == [], "it is being read"
    refuse()
    assert [alarm.last_at for _, alarm in store.alarms.check()] == [START]
    upload(store)
    assert store.alarms.check() == []
    refuse()
    assert store.alarms.check() == []
    upload(store)
    finish(store)
    assert store.alarms.check() != []
    assert events_of(store) == [("opened", "no-phantom-scan"), ("closed", "no-phantom-scan")]


def test_a_scanner_that_cannot_be_read_is_logged_and_keeps_its_alarms_while_others_get_theirs(
    store, scanner, upload, finish, clock
):
    limited(store, scanner, quiet_after_hours=1)
    other = store.scanners.create(store.scanners.get(scanner.id), scanner_id="other").id
    measured = phantom(store, date(2028, 3, 3))
    upload(store, phantom_id=measured)
    finish(store)
    clock.advance(hours=2)
    drawing = {"measurements": [{"dimension": "x", "measured_mm": "long"}]}
    with store.database.write() as session:
        session.execute(update(PhantomRow).where(PhantomRow.id == measured).values(drawing=drawing))
    with capture_logs() as log:
        assert {alarm.scanner_id for _, alarm in store.alarms.check()} == {other}
    logged = {(entry["event"], entry["scanner_id"]) for entry in log}
    assert logged == {("alarms-unreadable", scanner.id), ("event", other)}
    with store.database.write() as session:
        spec = store.scanners.get(other).model_dump(mode="json") | {"alarms": {"quiet_after_hours": "often"}}
        session.execute(update(ScannerRow).where(ScannerRow.id == other).values(spec=spec))
    with capture_logs() as log:
        assert store.alarms.check() == []
    assert {entry["scanner_id"] for entry in log} == {scanner.id, other}
    assert [alarm.scanner_id for alarm in store.alarms.open()] == [other]


def test_deleting_scans_opens_no_alarm_and_ends_none(store, scanner, upload, finish, clock):
    limited(store, scanner, phantom_scan_every_days=10, quiet_after_hours=100)
    clock.advance(days=9)
    calibrated = upload(store).id
    finish(store)
    store.calibrations.accept(CalibrationRequest(scan_id=calibrated))
    finish(store)
    last = upload(store, phantom_id=None).id
    finish(store)
    store.scans.delete(calibrated)
    store.scans.delete(last)
    clock.advance(days=2)
    assert store.alarms.check() == []
    clock.advance(days=8)
    assert {alarm.last_at for _, alarm in store.alarms.check()} == {START + timedelta(days=9)}
    assert store.alarms.check() == []


def test_a_round_takes_no_longer_for_each_of_many_scanners_than_for_one(store, scanner, clock):
    """Alarms are looked up, not compared with each other."""
    limited(store, scanner, quiet_after_hours=1)
    for _ in range(20):
        store.scanners.create(store.scanners.get(scanner.id))
    clock.advance(hours=2)
    store.alarms.check()
    compared = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Alarm, "__eq__", lambda *_: bool(compared.append(1)))
        store.alarms.check()
    assert len(compared) <= 21
