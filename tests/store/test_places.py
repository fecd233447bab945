"""How many jobs may wait, in all and of one key, on each database."""

from contextlib import closing

import pytest
from results import CONSTANTS, answer_of, plan_result

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.plans import PlanAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.acting import Actor, acting_as
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.errors import QueueFull
from sawmill_platform.jobs.job_store import Retries
from sawmill_platform.jobs.queue_limits import LONGEST_RETRY_S, RETRY_IF_UNKNOWN_S
from sawmill_platform.settings import StorageSettings
from sawmill_store.mill_tables import ScheduleRow
from sawmill_store.store import Store
from sawmill_vocabulary import Theta

NOMINAL = Theta(
    initial_angle_rad=0.0, detector_to_cor_mm=740.0, source_shift_mm=200.0, detector_shift_mm=30.0, detector_tilt=0.2
)
SOMEBODY = Actor("somebody without a key")


@pytest.fixture
def settings(settings) -> StorageSettings:
    return settings.model_copy(update={"max_queued_jobs": 6, "max_queued_jobs_per_key": 4})


@pytest.fixture
def plan(store, scanner):
    def ask(views=20):
        return store.plans.accept(
            PlanAsk(scanner_id=scanner.id, theta=NOMINAL, views=views), given={"phantom_id": "l-shape"}
        )

    return ask


def test_a_place_is_free_when_a_job_starts_and_not_taken_from_one_that_comes_back(store, plan):
    with acting_as(SOMEBODY):
        for views in range(20, 26):
            plan(views)
        claim = store.jobs.claim("test")
        plan(26)
        lost = Failure(kind=FailureKind.PASSING, code="worker-lost", detail="killed")
        assert store.jobs.fail(claim, lost, retries=Retries(loss_wait_s=1000.0)) is JobState.QUEUED
        assert store.places.waiting().in_all == 7  # its delay is a wait like any other
        with pytest.raises(QueueFull, match="7 jobs wait, and 6 may"):
            plan(27)


def test_a_scan_and_its_calibration_get_places_together_or_neither(store, plan, upload):
    def both():
        with store.as_one():
            scan = upload(store)
            store.calibrations.accept(CalibrationAsk(scan_id=scan.id))

    with acting_as(SOMEBODY):
        for views in range(20, 25):
            plan(views)
        with pytest.raises(QueueFull):
            both()
        assert store.scans.page().items == []
        upload(store)


@pytest.mark.usefixtures("ready_scan")
def test_what_a_schedule_asks_for_is_never_lost_and_its_event_says_that_it_waits_beyond_the_limit(store, scanner, plan):
    schedule = store.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="* * * * *"))
    with acting_as(SOMEBODY):
        for views in range(20, 26):
            plan(views)
    with store.database.write() as session:
        session.get(ScheduleRow, schedule.id).next_due_at = store.now()
    (run,) = store.schedules.run_due()
    assert run.outcome == "queued"
    job_id = store.calibrations.get(run.calibration_id).job_id
    [event] = [event for event in store.events.following(0) if event.job_id == job_id]
    assert event.what is event_kinds.QUEUED
    assert event.detail == {
        "reason": "6 jobs wait, and 6 may in all (SAWMILL_MAX_QUEUED_JOBS): this one is the service's own and waits as "
        "well"
    }


def test_when_to_come_back_follows_from_how_long_jobs_take_and_is_bounded(clocked_store, clock):
    store = clocked_store
    line = store.scanners.create(ScannerSpec(name="Line 2", constants=ScannerConstants(**CONSTANTS)))

    def plan(views):
        ask = PlanAsk(scanner_id=line.id, theta=NOMINAL, views=views)
        store.plans.accept(ask, given={"phantom_id": "l-shape"})

    def retry_after_s():
        with acting_as(SOMEBODY), pytest.raises(QueueFull) as full:
            store.places.check()
        return full.value.retry_after_s

    def take(seconds, claim=None):
        claim = claim or store.jobs.claim("test")
        clock.advance(seconds=seconds)
        answer = answer_of(claim.job.kind, plan_result())
        store.jobs.succeed(claim, answer, store.files.make_attempt_folder(claim.job_id, claim.attempt))

    for views in range(20, 30):
        plan(views)
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
    with closing(Store(store.settings, clock=clock)) as store:  # which knows how long that took
        assert retry_after_s() == LONGEST_RETRY_S
