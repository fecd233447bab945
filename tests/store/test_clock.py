"""The store's time: no process's own clock moves it, but that of the one that owns it."""

import time
from datetime import UTC, datetime, timedelta

import pytest
from databases import sqlite_alone

from sawmill_platform.contracts import event_kinds
from sawmill_platform.database.tables import ClockRow
from sawmill_platform.workers.clock_keeper import LASTING_S, ClockKeeper
from sawmill_store.store import Store

HOURS = timedelta(hours=2)


def now(store: Store) -> datetime:
    return store.database.now()


@pytest.mark.dialect
@pytest.mark.parametrize("hours", [2, -2])
def test_it_is_the_machine_s_at_first_also_for_a_process_whose_clock_is_off(store, settings, moved_clock, hours):
    right = now(store)
    assert abs(right - datetime.now(UTC)) < timedelta(minutes=1)
    assert abs(store.clock_off_s()) < 60.0
    moved_clock(ahead_s=3600.0 * hours)
    other = Store.open(settings)
    assert abs(now(other) - right) < timedelta(minutes=1)
    assert abs(other.clock_off_s() - 3600.0 * hours) < 60.0
    other.close()


@sqlite_alone
def test_an_old_boot_s_time_is_written_over(store, settings):
    with store.database.write() as session:
        row = session.get(ClockRow, 1)
        row.boot, row.offset_s = "an earlier one", 0.0
    again = Store.open(settings)
    assert abs(now(again) - datetime.now(UTC)) < timedelta(minutes=1)
    again.close()


@sqlite_alone
def test_a_lasting_step_is_taken_over_with_an_event_and_a_short_one_is_not(store, moved_clock):
    passed_s = [0.0]
    keeper = ClockKeeper(store, monotonic=lambda: passed_s[-1])

    def look(*moments_s: float) -> None:
        for moment_s in moments_s:
            passed_s.append(moment_s)
            keeper.look(lasting_s=LASTING_S)

    moved_clock(ahead_s=7200.0)
    look(1.0, LASTING_S + 0.5)
    moved_clock()
    look(100.0, 100.0 + LASTING_S)
    moved_clock(ahead_s=7200.0)
    look(200.0, 199.5 + LASTING_S)
    assert store.events.of_clock() == []
    before = now(store)
    look(200.0 + LASTING_S)
    (event,) = store.events.of_clock()
    assert (event.what, round(event.detail["off_s"])) == (event_kinds.CLOCK_STEPPED, 7200)
    assert HOURS - timedelta(minutes=1) < now(store) - before < HOURS + timedelta(minutes=1)
    assert abs(store.clock_off_s()) < 60.0


@sqlite_alone
def test_the_keeper_looks_again_and_again(store):
    looks = []

    class Noting(ClockKeeper):
        def look(self, *, lasting_s):
            looks.append(lasting_s)

    with Noting(store, lasting_s=5.0, look_s=0.01):
        deadline = time.monotonic() + 60.0
        while len(looks) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert looks[:3] == [0.0, 5.0, 5.0], "a step before the start counts at once"


def test_no_wall_clock_has_a_part_in_it_once_it_is_known(store, moved_clock):
    before = now(store)
    moved_clock(ahead_s=7200.0)
    assert now(store) - before < timedelta(minutes=1)
    store.database.clock.refresh()
    assert now(store) - before < timedelta(minutes=1)
