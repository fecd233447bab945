"""The store's time: no process's own clock moves it, but that of the one that owns it."""

import time
from datetime import UTC, datetime, timedelta

import pytest
from databases import sqlite_alone

from sawmill_worker.contracts.events import EventKind
from sawmill_worker.execution.clock_keeper import ClockKeeper
from sawmill_worker.storage import clock
from sawmill_worker.storage.store import Store
from sawmill_worker.storage.tables import ClockRow

HOURS = timedelta(hours=2)


def off_by(monkeypatch, hours: float) -> None:
    """Move this process's own clock; CLOCK_BOOTTIME stays, as it does when a machine's clock is set."""
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() + 3600.0 * hours)


def now(store: Store) -> datetime:
    return store._database.now()


def test_it_is_the_machine_s_at_first(store):
    assert abs(now(store) - datetime.now(UTC)) < timedelta(seconds=1)
    assert abs(store.clock_off_s()) < 1.0


@pytest.mark.parametrize("hours", [2, -2])
def test_a_process_whose_clock_is_off_has_the_store_s_time(store, settings, monkeypatch, hours):
    right = now(store)
    off_by(monkeypatch, hours)
    other = Store.open(settings)
    assert abs(now(other) - right) < timedelta(seconds=5)
    assert abs(other.clock_off_s() - 3600.0 * hours) < 1.0
    other.close()


@sqlite_alone
def test_an_old_boot_s_time_is_written_over(store, settings):
    with store._database.write() as session:
        row = session.get(ClockRow, 1)
        row.boot, row.offset_s = "an earlier one", 0.0
    again = Store.open(settings)
    assert abs(now(again) - datetime.now(UTC)) < timedelta(seconds=1)
    again.close()


@pytest.mark.slow
@sqlite_alone
def test_a_lasting_step_is_taken_over_with_an_event_and_a_short_one_is_not(store, monkeypatch):
    with ClockKeeper(store, lasting_s=1.0, look_s=0.05):
        time.sleep(0.3)
        with monkeypatch.context() as stepped:
            off_by(stepped, 2)
            time.sleep(0.4)
        time.sleep(0.3)
        assert store.events.of_clock() == []
        before = now(store)
        off_by(monkeypatch, 2)
        deadline = time.monotonic() + 20.0
        while not store.events.of_clock():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        (event,) = store.events.of_clock()
    assert (event.what, round(event.detail["off_s"])) == (EventKind.CLOCK_STEPPED, 7200)
    assert HOURS - timedelta(seconds=5) < now(store) - before < HOURS + timedelta(seconds=30)
    assert abs(store.clock_off_s()) < 1.0


def test_no_wall_clock_has_a_part_in_it_once_it_is_known(store, monkeypatch):
    now(store)
    monkeypatch.setattr(clock, "machine_offset_s", lambda: pytest.fail("asked for the machine's own time"))
    now(store)
    store._database.clock.refresh()
