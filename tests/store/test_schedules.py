from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, date, datetime, time, timedelta
from zoneinfo import ZoneInfo

import pytest

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.jobs import Priority
from sawmill_store.mill_tables import ScannerRow, ScheduleRow
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.clocked

START = datetime(2026, 3, 2, 5, 0, tzinfo=UTC)


@pytest.fixture
def schedule(store, scanner):
    return store.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="*/30 * * * *"))


def missed(store, schedule):
    """The due times that were announced as missed, each with the reason."""
    events = (event for event in store.events.following(0) if event.type == "schedule-missed")
    return [(event.detail["due_at"], event.detail["reason"]) for event in events if event.subject_id == schedule.id]


def test_nothing_runs_before_its_time_or_while_disabled(store, scanner, schedule, clock):
    clock.advance(minutes=29)
    assert store.schedules.run_due() == []
    store.schedules.update(schedule.id, ScheduleSpec(scanner_id=scanner.id, cron="*/30 * * * *", enabled=False))
    clock.advance(hours=5)
    assert store.schedules.run_due() == []


def test_a_due_schedule_queues_the_newest_phantom_scan_once(store, schedule, clock, ready_scan):
    clock.advance(minutes=30)
    (run,) = store.schedules.run_due()
    assert (run.due_at, run.outcome) == (START.replace(minute=30), "queued")
    calibration = store.calibrations.get(run.calibration_id)
    assert (calibration.scan_id, calibration.schedule_id) == (ready_scan.id, schedule.id)
    assert store.schedules.run_due() == []
    after = store.schedules.get(schedule.id)
    assert (after.next_due_at, after.last_run) == (START.replace(hour=6), run)
    clock.advance(minutes=30)
    (next_run,) = store.schedules.run_due()
    assert next_run.outcome == "no-new-phantom-scan"
    assert store.schedules.runs(schedule.id) == [next_run, run]
    store.schedules.delete(schedule.id)
    asked = store.calibrations.get(run.calibration_id)
    assert (asked.schedule_id, store.jobs.get(asked.job_id).priority) == (schedule.id, Priority.BATCH)


@pytest.mark.usefixtures("ready_scan")
def test_times_missed_while_nothing_ran_are_run_once_for_the_latest(store, schedule, clock):
    clock.advance(hours=10, minutes=10)
    (run,) = store.schedules.run_due()
    assert run.due_at == START.replace(hour=15)
    assert store.schedules.get(schedule.id).next_due_at == START.replace(hour=15, minute=30)
    assert [reason for _, reason in missed(store, schedule)] == ["nothing ran schedules then"]


def test_a_due_time_that_came_back_by_an_edit_is_not_run_again(store, scanner, schedule, clock):
    clock.advance(minutes=30)
    store.schedules.run_due()
    clock.advance(minutes=-10)
    store.schedules.update(schedule.id, ScheduleSpec(scanner_id=scanner.id, cron="*/30 * * * *"))
    clock.advance(minutes=10)
    assert (store.schedules.run_due(), len(store.schedules.runs(schedule.id))) == ([], 1)
    assert store.schedules.get(schedule.id).next_due_at == START.replace(hour=6)


@pytest.mark.usefixtures("ready_scan")
@pytest.mark.parametrize(("on_pass", "active"), [("activate", True), ("report", False)])
def test_what_happens_on_a_pass_is_the_schedule_s_to_say(store, scanner, clock, finish, on_pass, active):
    schedule = store.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="* * * * *", on_pass=on_pass))
    clock.advance(minutes=1)
    (run,) = store.schedules.run_due()
    finish(store)
    assert (store.scanners.get(scanner.id).active_calibration_id == run.calibration_id) is active
    made, *activated = store.history.page(scanner.id, since=START).items[::-1][-2 if active else -1 :]
    assert (made.subject_id, made.who) == (run.calibration_id, f"schedule {schedule.id}")
    entries = [(entry.type, entry.who, schedule.id in entry.why) for entry in activated]
    assert entries == [("calibration-activated", f"schedule {schedule.id}", True)] * active


def log_scan(store, scanner, finish, clock, views=360, last_deg=359.0, averaged_rows=None):
    clock.advance(minutes=1)
    data = DataKind.COUNTS if averaged_rows is None else DataKind.LINE_INTEGRALS
    spec = ScanSpec(scanner_id=scanner.id, data=data, averaged_rows=averaged_rows)
    accepted = store.scans.accept(spec, store.files.receive([b"log"], max_bytes=10))
    rows = 16 if averaged_rows is None else 1
    finish(store, shape={"views": views, "rows": rows, "detector": 768}, angular_range_deg=[0.0, last_deg])
    return accepted.id


@pytest.fixture
def checks(store, scanner):
    about = {"kind": "check-drift", "cron": "*/30 * * * *", "drift_options": {"rows": "0:8"}}
    return store.schedules.create(ScheduleSpec(scanner_id=scanner.id, **about))


@pytest.fixture
def active(store, ready_scan, finish):
    asked = store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id, activate=True))
    finish(store)
    return asked


@pytest.mark.usefixtures("active")
def test_the_newest_log_that_is_fit_for_it_is_checked_for_drift_once(store, checks, scanner, finish, clock):
    log_scan(store, scanner, finish, clock)
    newest = log_scan(store, scanner, finish, clock, views=20, last_deg=171.0)
    log_scan(store, scanner, finish, clock, views=7)
    clock.advance(minutes=30)
    (run,) = store.schedules.run_due()
    assert (run.outcome, run.calibration_id) == ("queued", None)
    check = store.drifts.get(run.drift_id)
    assert (check.scan_id, check.options.rows) == (newest, "0:8")
    assert store.jobs.get(check.job_id).priority is Priority.BATCH
    assert store.schedules.runs(checks.id) == [run]
    # An older log shows the past, and the fit ones have been looked at.
    clock.advance(minutes=30)
    assert store.schedules.run_due()[0].outcome == "no-new-log-scan"
    store.drifts.accept(DriftRequest(scan_id=log_scan(store, scanner, finish, clock)))
    clock.advance(minutes=30)
    assert store.schedules.run_due()[0].outcome == "no-new-log-scan"


@pytest.mark.usefixtures("active", "checks")
@pytest.mark.parametrize("end", ["failed", "cancelled"])
def test_a_log_whose_check_came_to_nothing_does_not_stand_before_older_ones(store, scanner, finish, clock, end, refuse):
    older, newer = log_scan(store, scanner, finish, clock), log_scan(store, scanner, finish, clock)
    asked = store.drifts.accept(DriftRequest(scan_id=newer))
    if end == "cancelled":
        store.jobs.request_cancel(asked.job_id)
    else:
        refuse("it moved too far")
    clock.advance(minutes=30)
    (run,) = store.schedules.run_due()
    assert store.drifts.get(run.drift_id).scan_id == older


@pytest.mark.usefixtures("active", "checks")
def test_a_log_that_is_turned_between_passages_is_not_checked_for_drift(store, scanner, finish, clock):
    with store.database.write() as session:
        row = session.get(ScannerRow, scanner.id)
        row.spec = {**row.spec, "constants": {**row.spec["constants"], "object_turns": "between-passages"}}
    log_scan(store, scanner, finish, clock)
    clock.advance(minutes=30)
    assert store.schedules.run_due()[0].outcome == "no-new-log-scan"


def test_without_an_active_calibration_there_is_nothing_to_compare_a_log_with(store, checks, scanner, finish, clock):
    log_scan(store, scanner, finish, clock)
    clock.advance(minutes=30)
    assert store.schedules.run_due()[0].outcome == "no-active-calibration"
    ((_, reason),) = missed(store, checks)
    assert "no active calibration" in reason


@pytest.mark.dialect
@pytest.mark.usefixtures("active")
def test_a_schedule_that_keeps_missing_is_announced_when_it_begins(store, checks, scanner, finish, clock):
    def missed_after(due_times):
        for _ in range(due_times):
            clock.advance(minutes=30)
            store.schedules.run_due()
        return len(missed(store, checks))

    assert (missed_after(1), missed_after(4)) == (1, 1)
    log_scan(store, scanner, finish, clock)
    assert (missed_after(1), missed_after(4)) == (1, 2)
    # A week off is announced by itself, and what is missed after it as before.
    clock.advance(days=7)
    assert (missed_after(1), missed_after(4)) == (3, 3)
    *_, (_, reason) = missed(store, checks)
    assert reason.startswith("nothing ran schedules then; later there was no new scan of a log")
    # Somebody has put it right, or believes so.
    store.schedules.update(checks.id, ScheduleSpec(scanner_id=checks.scanner_id, kind="check-drift", cron=checks.cron))
    assert (missed_after(1), missed_after(4)) == (4, 4)


@pytest.mark.usefixtures("active", "checks")
def test_a_log_that_came_as_the_mean_of_rows_is_checked_whatever_rows_the_schedule_names(store, scanner, finish, clock):
    sent = log_scan(store, scanner, finish, clock, views=20, averaged_rows=1000)
    clock.advance(minutes=30)
    check = store.drifts.get(store.schedules.run_due()[0].drift_id)
    assert (check.scan_id, check.options.rows) == (sent, None)


@pytest.mark.usefixtures("active")
def test_a_schedule_that_cannot_run_is_missed_once_and_stops_no_other(store, scanner, finish, clock):
    spec = ScheduleSpec(scanner_id=scanner.id, kind="check-drift", cron="*/30 * * * *")
    # As an earlier version took it.
    outdated_spec = ScheduleSpec(scanner_id=scanner.id, cron=spec.cron, options={"views": 10**13})
    abroad, outdated, checks = (store.schedules.create(each) for each in (spec, outdated_spec, spec))
    with store.database.write() as session:
        session.get(ScheduleRow, abroad.id).time_zone = "Mars/Olympus"
    log_scan(store, scanner, finish, clock)
    clock.advance(minutes=29)
    (run,) = store.schedules.run_due()
    assert [run] == store.schedules.runs(checks.id)
    due = START.replace(minute=30)
    ((due_at, reason),) = missed(store, outdated)
    assert (due_at, reason.startswith("its options are not right: views: ")) == (due.isoformat(), True)
    assert store.schedules.get(outdated.id).next_due_at == START.replace(hour=6)
    assert store.schedules.run_due() == []
    # Another machine may know the time zone.
    assert store.schedules.get(abroad.id).next_due_at == due
    ((due_at, reason),) = missed(store, abroad)
    assert (due_at, "not 'Mars/Olympus'" in reason) == (due.isoformat(), True)
    clock.advance(minutes=30)
    store.schedules.run_due()
    assert [len(missed(store, each)) for each in (abroad, outdated)] == [1, 1], "as before"


@pytest.mark.dialect
def test_an_edit_keeps_a_due_time_that_has_come_or_says_that_it_is_missed(store, scanner, schedule, clock):
    spec = ScheduleSpec(scanner_id=scanner.id, cron="*/30 * * * *")
    clock.advance(minutes=31)
    due = START.replace(minute=30)
    assert store.schedules.update(schedule.id, spec.model_copy(update={"on_pass": "activate"})).next_due_at == due
    assert [run.due_at for run in store.schedules.run_due()] == [due]
    clock.advance(minutes=30)
    abroad = spec.model_copy(update={"time_zone": "Asia/Kolkata", "cron": "0 * * * *"})
    assert store.schedules.update(schedule.id, abroad).next_due_at == START.replace(hour=6, minute=30)
    changed = (START.replace(hour=6).isoformat(), "the schedule was changed before it ran")
    assert missed(store, schedule)[1:] == [changed]
    clock.advance(minutes=30)
    store.schedules.update(schedule.id, spec.model_copy(update={"enabled": False}))
    assert missed(store, schedule)[2:] == [(START.replace(hour=6, minute=30).isoformat(), changed[1])]


@pytest.mark.parametrize("restarted", [False, True])
def test_after_the_clock_was_put_back_schedules_run_as_before(store, schedule, clock, restarted):
    clock.advance(days=30)
    assert len(store.schedules.run_due()) == 1
    clock.advance(days=-30)
    again = Store(store.settings, clock=clock) if restarted else store
    assert again.schedules.run_due() == []
    assert again.schedules.get(schedule.id).next_due_at == START.replace(minute=30)
    clock.advance(minutes=30)
    assert [run.due_at for run in again.schedules.run_due()] == [START.replace(minute=30)]
    if restarted:
        again.close()


def run_due_at(settings, moment):
    store = Store(settings, clock=lambda: moment)
    ran = len(store.schedules.run_due())
    store.close()
    return ran


@pytest.mark.dialect
def test_each_due_time_runs_once_however_many_threads_look(store, schedule):
    moments = [START.replace(hour=hour) for hour in (6, 7, 8) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        ran = sum(pool.map(run_due_at, [store.settings] * len(moments), moments))
    times = [run.due_at for run in store.schedules.runs(schedule.id)]
    assert len(times) == len(set(times)) == ran
    assert times[0] == START.replace(hour=8)


def test_a_year_of_sundays_in_finland_runs_each_once_under_two_schedulers(store, scanner, clock):
    """Both days of change are Sundays, and 03:30 is in the hour that is jumped over, or comes twice."""
    spec = ScheduleSpec(scanner_id=scanner.id, cron="30 3 * * 0", time_zone="Europe/Helsinki")
    schedule = store.schedules.create(spec)
    second = Store(store.settings, clock=clock)
    ran = []
    with ThreadPoolExecutor(2) as pool:
        for _ in range(52):
            # At the time, and in the hour after it, when the clocks of a wall may show it again.
            for late in (timedelta(), timedelta(minutes=40), timedelta(minutes=60)):
                clock.now = (clock.now if late else store.schedules.get(schedule.id).next_due_at) + late
                for runs in pool.map(lambda each: each.schedules.run_due(), (store, second)):
                    ran += runs
    second.close()
    sundays = [date(2026, 3, 8) + timedelta(weeks=week) for week in range(52)]
    wall = {day: time(4) if day == date(2026, 3, 29) else time(3, 30) for day in sundays}
    zone = ZoneInfo("Europe/Helsinki")
    assert [run.due_at for run in ran] == [datetime.combine(day, wall[day], zone).astimezone(UTC) for day in sundays]
