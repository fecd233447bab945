"""The store's time, which one process's own clock does not move, and due times on days of change."""

from bisect import bisect_left
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from functools import cache
from itertools import pairwise, product
from operator import itemgetter
from zoneinfo import ZoneInfo

import pytest
from emptied_databases import sqlite_alone
from live_service import wait_until

from sawmill_platform.contracts import event_kinds
from sawmill_platform.database.tables import ClockRow
from sawmill_platform.due_times import latest_due, next_due
from sawmill_platform.workers.sole_service import LASTING_S, ClockKeeper
from sawmill_store.store import Store


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
    assert (event.type, round(event.detail["off_s"])) == (event_kinds.CLOCK_STEPPED, 7200)
    assert abs(now(store) - before - timedelta(hours=2)) < timedelta(minutes=1)
    assert abs(store.clock_off_s()) < 60.0


@sqlite_alone
def test_the_keeper_looks_again_and_again(store):
    looks = []

    class Noting(ClockKeeper):
        def look(self, *, lasting_s):
            looks.append(lasting_s)

    with Noting(store, lasting_s=5.0, look_s=0.01):
        wait_until(lambda: len(looks) >= 3)
    assert looks[:3] == [0.0, 5.0, 5.0], "a step before the start counts at once"


def test_no_wall_clock_has_a_part_in_it_once_it_is_known(store, moved_clock):
    before = now(store)
    moved_clock(ahead_s=7200.0)
    assert now(store) - before < timedelta(minutes=1)
    store.database.clock.refresh()
    assert now(store) - before < timedelta(minutes=1)


# Forward and back: in the north, in the south, by half an hour, at midnight, by two hours, against the summer, never.
CHANGES = {
    "Europe/Helsinki": ("2026-03-29", "2026-10-25"),
    "America/Santiago": ("2026-04-05", "2026-09-06"),
    "Australia/Lord_Howe": ("2026-04-05", "2026-10-04"),
    "Africa/Cairo": ("2026-04-24", "2026-10-30"),
    "Antarctica/Troll": ("2026-03-29", "2026-10-25"),
    "Africa/Casablanca": ("2026-02-15", "2026-03-22"),
    "UTC": ("2026-03-29",),
}
# Hours and minutes of the wall clock that each expression names.
NAMED = {
    "30 3 * * *": ({3}, {30}),
    "30 0 * * *": ({0}, {30}),
    "45 1 * * *": ({1}, {45}),
    "*/30 3 * * *": ({3}, {0, 30}),
    "0,30 1-4 * * *": ({1, 2, 3, 4}, {0, 30}),
    "0 */3 * * *": ({0, 3, 6, 9, 12, 15, 18, 21}, {0}),
}


def utc(day: str, clock: str) -> datetime:
    return datetime.fromisoformat(f"{day}T{clock}:00+00:00")


def following(cron: str, zone: str, start: datetime, end: datetime) -> Iterator[datetime]:
    due = start
    while (due := next_due(cron, zone, due)) <= end:
        yield due


def days_around(day: str) -> tuple[datetime, datetime]:
    return utc(day, "00:00") - timedelta(days=1.2), utc(day, "00:00") + timedelta(days=2.2)


@cache
def on_the_wall(zone: str, start: datetime, end: datetime) -> list[tuple[datetime, datetime]]:
    """Every minute that a wall clock shows in that time, in the wall's order, with the first moment when it does."""
    shown: dict[datetime, datetime] = {}
    for minute in range(int((end - start) / timedelta(minutes=1)) + 1):
        moment = start.replace(second=0, microsecond=0) + timedelta(minutes=minute)
        shown.setdefault(moment.astimezone(ZoneInfo(zone)).replace(tzinfo=None), moment)
    return sorted(shown.items())


def once_each(cron: str, zone: str, start: datetime, end: datetime) -> list[datetime]:
    """The first moment of each named minute; of one that is jumped over, the first minute after it."""
    hours, minutes = NAMED[cron]
    shown = on_the_wall(zone, start, end)
    found, midnight, last = set(), shown[0][0].replace(hour=0, minute=0), shown[-1][0]
    for days in range((last - midnight).days + 1):
        for hour, minute in product(hours, minutes):
            wall = midnight + timedelta(days=days, hours=hour, minutes=minute)
            if wall <= last:
                found.add(shown[bisect_left(shown, wall, key=itemgetter(0))][1])
    return sorted(moment for moment in found if start < moment <= end)


@pytest.mark.parametrize("zone", CHANGES)
@pytest.mark.parametrize("cron", NAMED)
def test_a_named_hour_comes_once_on_each_day_of_change(zone, cron):
    for day in CHANGES[zone]:
        start, end = days_around(day)
        due = once_each(cron, zone, start, end)
        assert list(following(cron, zone, start, end)) == due
        for one, after in pairwise(due):
            for now in (one, one + timedelta(seconds=1.5), after - timedelta(seconds=0.5)):
                assert latest_due(cron, zone, now) == one
                assert next_due(cron, zone, now) == after


@pytest.mark.parametrize("zone", [zone for zone in CHANGES if zone != "Australia/Lord_Howe"])
def test_every_hour_is_each_hour_that_passes(zone):
    for day in CHANGES[zone]:
        start, end = days_around(day)
        due = list(following("15 * * * *", zone, start, end))
        assert {after - one for one, after in pairwise(due)} == {timedelta(hours=1)}
        quarters = list(following("*/15 * * * *", zone, start, end))
        assert {after - one for one, after in pairwise(quarters)} == {timedelta(minutes=15)}


def test_every_hour_stays_at_its_minute_where_clocks_move_by_half_an_hour():
    for day in CHANGES["Australia/Lord_Howe"]:
        due = list(following("30 * * * *", "Australia/Lord_Howe", *days_around(day)))
        assert {moment.astimezone(ZoneInfo("Australia/Lord_Howe")).minute for moment in due} == {30}
        assert max(after - one for one, after in pairwise(due)) <= timedelta(minutes=90)
