"""The queue: whose turn it is, a job's place and the time that it still waits, and how many may wait."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from datetime import timedelta
from itertools import count, islice

import pytest
from results import succeed
from sqlalchemy import event

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState, Priority
from sawmill_platform.database.database import newest_revision
from sawmill_platform.errors import QueueFull, StorageUnavailable
from sawmill_platform.jobs.job_store import Pulse, Retries
from sawmill_platform.jobs.queue_limits import LONGEST_RETRY_S, RETRY_IF_UNKNOWN_S
from sawmill_platform.jobs.tallies import SETTLED, Amount, Fate, Tallies
from sawmill_platform.jobs.wait_estimate import Selection
from sawmill_platform.ledger.events import Actor, acting_as
from sawmill_store.mill_tables import ScheduleRow
from sawmill_store.store import Store
from sawmill_vocabulary import CalibrationMethod, Progress, Theta

pytestmark = pytest.mark.clocked


def claimed(store, number, selection=Selection()):  # noqa: B008 - frozen
    claims = [store.jobs.claim("test", selection) for _ in range(number)]
    return [claim and claim.job_id.partition("-")[0] for claim in claims]


@pytest.mark.dialect
def test_a_batch_of_one_line_does_not_delay_another_line_s_job(store, add_jobs):
    add_jobs(200, kinds.RECONSTRUCT, group_id="a")
    assert claimed(store, 2) == ["a", "a"]
    add_jobs(1, kinds.RECONSTRUCT, group_id="b")
    assert claimed(store, 2) == ["b", "a"]
    add_jobs(3, kinds.RECONSTRUCT, group_id="b")
    add_jobs(2, kinds.RECONSTRUCT, group_id="c")
    line = store.jobs.waiting_in_line(limit=8)
    assert [job.queue_position for job in line] == list(range(8))
    expected = [job.id.partition("-")[0] for job in line]
    assert expected == ["c", "b", "a", "c", "b", "a", "b", "a"]
    assert claimed(store, 8) == expected


@pytest.mark.dialect
def test_a_job_is_read_while_another_line_s_first_job_is_added(store, add_jobs):
    add_jobs(1, kinds.RECONSTRUCT, group_id="a")
    [waiting] = store.jobs.waiting_in_line()
    adding = iter(["b"])

    def add(*given):
        if "job_turns" in given[2]:  # the second of two statements: the first one has read the jobs that wait
            for group_id in adding:
                add_jobs(1, kinds.RECONSTRUCT, group_id=group_id)

    event.listen(store.database.engine, "before_cursor_execute", add)
    assert store.jobs.get(waiting.id).queue_position == 0
    assert next(adding, None) is None
    assert len(store.jobs.waiting_in_line()) == 2


def test_turns_are_of_a_priority_and_of_the_workers_of_a_lane(store, add_jobs):
    add_jobs(3, kinds.RECONSTRUCT, group_id="a", priority=Priority.BATCH)
    add_jobs(2, kinds.RECONSTRUCT, group_id="b", priority=Priority.BATCH)
    add_jobs(1, kinds.RECONSTRUCT, group_id="a")
    add_jobs(1, kinds.RECONSTRUCT, group_id="b")
    add_jobs(3, kinds.CALIBRATE, group_id="a", short=True)
    assert claimed(store, 4, Selection(short=True)) == ["a", "a", "a", None]
    assert claimed(store, 7) == ["a", "b", "a", "b", "a", "b", "a"]


@pytest.mark.dialect
def test_a_worker_takes_the_kinds_and_groups_that_it_was_given(store, add_jobs):
    add_jobs(2, kinds.RECONSTRUCT, group_id="a")
    add_jobs(1, kinds.CALIBRATE, group_id="b")
    add_jobs(2, kinds.RECONSTRUCT, group_id="b")
    assert claimed(store, 2, Selection(kinds=frozenset({kinds.CALIBRATE}))) == ["b", None]
    assert claimed(store, 3, Selection(group_ids=frozenset({"b"}))) == ["b", "b", None]
    assert claimed(store, 3) == ["a", "a", None]


@pytest.mark.dialect
@pytest.mark.slow
def test_many_workers_serve_groups_alike_and_each_job_once(store, add_jobs):
    for group_id in ("a", "b", "c"):
        add_jobs(30, kinds.RECONSTRUCT, group_id=group_id)

    def claim_some(_):
        opened, taken = Store(store.settings), []
        while len(taken) < 10:
            with suppress(StorageUnavailable):  # as a worker does: six keep each other waiting on a slow disk
                taken.append(opened.jobs.claim("racer").job_id)
        opened.close()
        return taken

    with ThreadPoolExecutor(6) as pool:
        taken = [job_id for some in pool.map(claim_some, range(6)) for job_id in some]
    assert len(set(taken)) == 60
    # Half of an equal share at least: on PostgreSQL claims at the same moment see the same turn.
    assert min(Counter(job_id.partition("-")[0] for job_id in taken).values()) >= 10


def waits(store):
    jobs = store.jobs.page(state=JobState.QUEUED, limit=200).items
    assert [store.jobs.get(job.id) for job in jobs] == jobs  # alone as in a list
    order = list(store.jobs.queued_job_ids())
    return [(job.queue_position, job.seconds_left) for job in sorted(jobs, key=lambda job: order.index(job.id))]


@pytest.mark.dialect
def test_places_and_claims_follow_priority_and_lane(store, add_jobs):
    add_jobs(2, kinds.RECONSTRUCT, priority=Priority.BACKGROUND)
    add_jobs(2, kinds.CALIBRATE, short=True, priority=Priority.BATCH)
    add_jobs(1, kinds.RECONSTRUCT)
    add_jobs(2, kinds.PLAN, short=True)
    add_jobs(1, kinds.RECONSTRUCT, priority=Priority.BATCH)
    order = list(store.jobs.queued_job_ids())
    named = [name.partition("-")[0] for name in order]
    assert named == ["reconstruct", *["plan"] * 2, *["calibrate"] * 2, *["reconstruct"] * 3]
    # A short job waits for short ones only, another one for all.
    assert [place for place, _ in waits(store)] == [0, 0, 1, 2, 3, 5, 6, 7]
    assert [store.jobs.claim("test").job_id for _ in order] == order


def test_a_list_takes_as_many_statements_whatever_its_length(store, add_jobs):
    add_jobs(150, kinds.RECONSTRUCT)
    add_jobs(40, kinds.PLAN, short=True, priority=Priority.BATCH)
    store.jobs.page(limit=1)
    statements = []
    event.listen(store.database.engine, "before_cursor_execute", lambda *given: statements.append(given[2]))
    assert len(store.jobs.page(limit=200).items) == 190
    # The page, what runs, and in each lane what waits and whose turn it is; how long jobs took is known by now.
    assert sum(statement.startswith(("SELECT", "WITH")) for statement in statements) == 6


def test_the_time_left_adds_up_what_runs_and_what_stands_before(store, add_jobs, clock):
    add_jobs(1, kinds.RECONSTRUCT)
    assert waits(store) == [(0, None)]  # nothing is known yet
    add_jobs(5, kinds.RECONSTRUCT, took_s=600.0)
    add_jobs(20, kinds.RECONSTRUCT, took_s=100.0)  # the last twenty count
    add_jobs(3, kinds.PLAN, took_s=4.0, short=True)
    later = Store(store.settings, clock=clock)
    add_jobs(1, kinds.RECONSTRUCT)
    add_jobs(2, kinds.PLAN, short=True)
    assert waits(later) == [(0, 100.0), (1, 200.0), (0, 4.0), (1, 8.0)]
    first = later.jobs.claim("test")
    clock.advance(seconds=30.0)
    assert later.jobs.get(first.job_id).seconds_left == 70.0
    assert waits(later) == [(0, 170.0), (0, 4.0), (1, 8.0)]
    later.jobs.heartbeat(first, Progress(fraction=0.5, stage="slices"))  # half of it took 30 s
    assert waits(later)[0] == (0, 130.0)
    later.jobs.heartbeat(first, Progress(fraction=0.5, stage="slices", seconds_left=20.0))
    assert waits(later)[0] == (0, 120.0)
    later.close()


def test_what_is_known_to_take_seconds_is_short(store, upload):
    scan = upload(store)
    asked = [store.calibrations.accept(CalibrationRequest(scan_id=scan.id, method=each)) for each in CalibrationMethod]
    slices = store.reconstructions.accept(ReconstructionRequest(scan_id=scan.id, calibration_id=asked[0].id))
    short = [store.jobs.get(each.job_id).short for each in (scan, *asked, slices)]
    assert short == [True, *(method is CalibrationMethod.DEFAULT for method in CalibrationMethod), False]


def test_short_jobs_can_be_claimed_alone(store, add_jobs):
    add_jobs(1, kinds.RECONSTRUCT)
    add_jobs(1, kinds.PLAN, short=True, priority=Priority.BACKGROUND)
    assert len(store.jobs.queued_job_ids(short=True)) == 1
    taken = store.jobs.claim("test", Selection(short=True))
    assert (taken.job.kind, taken.job.short, taken.job.background) == (kinds.PLAN, True, True)
    assert store.jobs.claim("test", Selection(short=True)) is None
    # A long job that waits is no reason to give a short lane's worker back.
    assert not store.jobs.is_in_the_way(taken)
    store.jobs.release(taken)
    assert store.jobs.claim("test").job.kind is kinds.RECONSTRUCT
    again = store.jobs.claim("test")
    add_jobs(1, kinds.RECONSTRUCT)
    assert store.jobs.is_in_the_way(again)


def test_a_short_job_is_held_up_while_long_ones_keep_every_worker_busy(store, add_jobs):
    add_jobs(1, kinds.RECONSTRUCT)
    add_jobs(1, kinds.RECONSTRUCT, priority=Priority.BATCH)
    add_jobs(1, kinds.PLAN, short=True, priority=Priority.BATCH)
    assert not store.jobs.short_job_is_held_up(1)
    store.jobs.claim("test")
    assert (store.jobs.short_job_is_held_up(1), store.jobs.short_job_is_held_up(2)) == (True, False)
    store.jobs.claim("test")
    assert store.jobs.short_job_is_held_up(2)
    store.jobs.claim("test")
    assert not store.jobs.short_job_is_held_up(2)


NOMINAL = Theta(2.55, 714.7, 319.9, 43.7, 0.281)
SOMEBODY = Actor("somebody without a key")


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"max_queued_jobs": 6, "max_queued_jobs_per_key": 4})


@pytest.fixture
def plan(store, scanner):
    numbers = count(20)

    def plan(times=1):
        for views in islice(numbers, times):
            ask = PlanRequest(scanner_id=scanner.id, theta=NOMINAL, views=views)
            store.plans.accept(ask, given={"phantom_id": "l-shape"})

    return plan


def test_a_place_is_free_when_a_job_starts_and_not_taken_from_one_that_comes_back(store, plan):
    with acting_as(SOMEBODY):
        plan(6)
        claim = store.jobs.claim("test")
        plan()
        lost = Failure(kind=FailureKind.PASSING, code="worker-lost", detail="killed")
        assert store.jobs.fail(claim, lost, retries=Retries(loss_wait_s=1000.0)) is JobState.QUEUED
        assert store.places.waiting().in_all == 7  # its delay is a wait like any other
        with pytest.raises(QueueFull, match="7 jobs wait, and 6 may"):
            plan()


def test_a_scan_and_its_calibration_get_places_together_or_neither(store, plan, upload):
    def both():
        with store.database.write_as_one():
            store.calibrations.accept(CalibrationRequest(scan_id=upload(store).id))

    with acting_as(SOMEBODY):
        plan(5)
        with pytest.raises(QueueFull):
            both()
        assert store.scans.page().items == []
        upload(store)


@pytest.mark.usefixtures("ready_scan")
def test_what_a_schedule_asks_for_is_never_lost_and_its_event_says_that_it_waits_beyond_the_limit(store, scanner, plan):
    schedule = store.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="* * * * *"))
    with acting_as(SOMEBODY):
        plan(6)
    with store.database.write() as session:
        session.get(ScheduleRow, schedule.id).next_due_at = store.now()
    (run,) = store.schedules.run_due()
    assert run.outcome == "queued"
    job_id = store.calibrations.get(run.calibration_id).job_id
    [event] = [event for event in store.events.following(0) if event.job_id == job_id]
    full = "6 jobs wait, and 6 may in all (SAWMILL_MAX_QUEUED_JOBS)"
    assert event.type is event_kinds.QUEUED
    assert event.detail == {"reason": f"{full}: this one is the service's own and waits as well"}


def test_when_to_come_back_follows_from_how_long_jobs_take_and_is_bounded(store, plan, clock):
    def retry_after_s(opened=store):
        with acting_as(SOMEBODY), pytest.raises(QueueFull) as full:
            opened.places.check()
        return full.value.retry_after_s

    def take(seconds, claim=None):
        claim = claim or store.jobs.claim("test")
        clock.advance(seconds=seconds)
        succeed(store, claim)

    plan(10)
    assert retry_after_s() == RETRY_IF_UNKNOWN_S
    take(20.0)
    assert retry_after_s() == RETRY_IF_UNKNOWN_S  # nothing runs: there may be no worker
    running = store.jobs.claim("test")
    clock.advance(seconds=5)
    assert retry_after_s() == 15
    clock.advance(seconds=100)
    assert retry_after_s() == 1
    take(50_000.0, running)
    store.jobs.claim("test")
    with closing(Store(store.settings, clock=clock)) as later:  # which knows how long that took
        assert retry_after_s(later) == LONGEST_RETRY_S


REFUSED = Failure(kind=FailureKind.INPUT, code="broken-file", detail="it is damaged")
SUCCEEDED, FAILED, LOST = event_kinds.SUCCEEDED, event_kinds.FAILED, event_kinds.LOST


def end(store, upload, clock, seconds, *, peak_memory_bytes=None, failure=None):
    upload(store)
    claim = store.jobs.claim("host-1")
    clock.advance(seconds=seconds)
    if failure is not None:
        store.jobs.fail(claim, failure, peak_memory_bytes=peak_memory_bytes)
    else:
        succeed(store, claim, peak_memory_bytes=peak_memory_bytes)


def of_ingest(what, *, duration):
    return Fate(what, kinds.INGEST, None, None, duration)


@pytest.mark.dialect
def test_ends_are_classed_by_how_long_they_took_and_what_went_wrong(store, upload, clock):
    end(store, upload, clock, 0.5, peak_memory_bytes=3_000_000_000)
    end(store, upload, clock, 0.75, peak_memory_bytes=1_000_000_000)
    end(store, upload, clock, 20.0)
    end(store, upload, clock, 1.0, failure=REFUSED, peak_memory_bytes=500)
    fates = store.tallies.read().fates
    assert fates[of_ingest(SUCCEEDED, duration=1)] == pytest.approx((2, 1.25, 2, 4e9, 3e9), abs=1e-3)
    assert fates[of_ingest(SUCCEEDED, duration=4)] == pytest.approx((1, 20.0, 0, 0.0, 0.0), abs=1e-3)
    (failed,) = (fate for fate in fates if fate.type is FAILED)
    assert (failed.fault, failed.code, fates[failed].number) == ("input", "broken-file", 1)


@pytest.mark.dialect
def test_what_is_counted_grows_whether_it_was_counted_before_or_not(store, upload, clock):
    """What has settled is read once, and what has not each time: together each attempt counts once."""
    counts = []
    for number in range(3):
        end(store, upload, clock, 1.5)
        counts.append(store.tallies.read().fates[of_ingest(SUCCEEDED, duration=2)].number)
        assert number or not store.tallies.counted_to, "an event of a lower number may be committed later"
        clock.advance(seconds=0.6 * SETTLED.total_seconds())
    assert counts == [1, 2, 3]
    assert store.tallies.read().fates == Tallies(store.database).read().fates
    assert store.tallies.counted_to > 0


@pytest.mark.dialect
def test_jobs_are_counted_by_kind_and_state_with_the_age_of_the_oldest(store, upload, clock):
    for _ in range(2):
        upload(store)
        clock.advance(seconds=30)
    store.jobs.claim("host-1")
    clock.advance(seconds=5)
    tally = store.tallies.read()
    assert tally.jobs == {(kinds.INGEST, JobState.QUEUED): 1, (kinds.INGEST, JobState.RUNNING): 1}
    assert (tally.queued_s, tally.running_s) == ({kinds.INGEST: 35.0}, {kinds.INGEST: 5.0})


def test_a_lost_attempt_and_a_job_cancelled_in_the_queue(store, upload):
    upload(store)
    claim = store.jobs.claim("host-1")
    store.jobs.take_back(Pulse(claim.job_id, claim.attempt, 0, cancel_requested=False))
    store.jobs.request_cancel(claim.job_id)
    ((fate, amount),) = store.tallies.read().fates.items()
    assert (fate.type, fate.code, amount) == (LOST, "worker-lost", Amount(1, 0.0, 0, 0.0, 0.0))


def test_workers_are_seen_for_a_while(store, upload, clock):
    end(store, upload, clock, 1.0)
    upload(store)
    store.jobs.claim("host-2")
    assert store.tallies.read().workers == 2
    clock.advance(hours=1)
    assert store.tallies.read().workers == 1  # it holds its attempt still


@pytest.mark.dialect
def test_workers_are_known_by_their_last_attempt(store, upload, clock):
    for _ in range(2):
        upload(store)
    begun = clock()
    store.jobs.claim("mill-1")
    clock.advance(minutes=5)
    store.jobs.claim("mill-2")
    assert list(store.events.workers_since(begun).items()) == [("mill-2", clock()), ("mill-1", begun)]
    assert list(store.events.workers_since(begun + timedelta(seconds=1))) == ["mill-2"]


@pytest.mark.dialect
def test_a_database_reports_what_it_is(store, database_url, upload):
    report = store.database_report()
    assert report.system.startswith("PostgreSQL" if database_url else "SQLite")
    assert report.migration == report.newest_migration == newest_revision()
    assert 0 < report.answered_s < 60  # it answered; how fast is the machine's
    assert report.size_bytes > 100_000  # thirty tables and indexes of a page each, at least
    before = store.scans.uploaded_bytes()
    scan = upload(store)
    assert store.scans.uploaded_bytes() == before + scan.size_bytes
