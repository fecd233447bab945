"""Places in the queue and the time that jobs may still take."""

import pytest
from sqlalchemy import event

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_platform.contracts.jobs import JobState, Priority
from sawmill_platform.jobs.wait_estimate import Selection
from sawmill_store.store import Store
from sawmill_vocabulary import CalibrationMethod, Progress

pytestmark = pytest.mark.clocked


def waits(store):
    """Each queued job's place and time, the next one first."""
    jobs = store.jobs.page(state=JobState.QUEUED, limit=200).items
    assert [store.jobs.get(job.id) for job in jobs] == jobs  # alone as in a list
    order = list(store.jobs.queued_job_ids())
    return [(job.queue_position, job.seconds_left) for job in sorted(jobs, key=lambda job: order.index(job.id))]


def test_places_follow_priority_and_lane(store, add_jobs):
    add_jobs(2, kinds.RECONSTRUCT, priority=Priority.BACKGROUND)
    add_jobs(2, kinds.CALIBRATE, short=True, priority=Priority.BATCH)
    add_jobs(1, kinds.RECONSTRUCT)
    add_jobs(2, kinds.PLAN, short=True)
    add_jobs(1, kinds.RECONSTRUCT, priority=Priority.BATCH)
    order = list(store.jobs.queued_job_ids())
    assert [name.partition("-")[0] for name in order] == [
        *("reconstruct", "plan", "plan"),
        *("calibrate", "calibrate", "reconstruct"),
        *("reconstruct", "reconstruct"),
    ]
    # A short job waits for short ones only, another one for all.
    assert [place for place, _ in waits(store)] == [0, 0, 1, 2, 3, 5, 6, 7]


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
    by_method = {
        method: store.calibrations.accept(CalibrationAsk(scan_id=scan.id, method=method))
        for method in CalibrationMethod
    }
    slices = store.reconstructions.accept(
        ReconstructionAsk(scan_id=scan.id, calibration_id=by_method[CalibrationMethod.DEFAULT].id)
    )
    asked = [scan, *by_method.values(), slices]
    assert [store.jobs.get(each.job_id).short for each in asked] == [
        True,
        *(method is CalibrationMethod.DEFAULT for method in CalibrationMethod),
        False,
    ]


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
