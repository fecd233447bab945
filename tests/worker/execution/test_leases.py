"""Leases: silence is counted by the observer's own monotonic clock, look by look."""

import threading
import time
from collections.abc import Callable

import pytest
from live_service import wait_until
from write_lock import write_lock

from sawmill_platform.attempts.patience import LeaseObserver
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.jobs.job_store import Pulse
from sawmill_worker.housekeeping import MillHousekeeping


class Looks:
    """An observer that looks every two seconds at a lease of 60 s."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.observer = LeaseObserver(60.0, 12.0, 2.0, monotonic=lambda: self.now)

    def look(self, *pulses: Pulse, after_s: float = 2.0) -> list[str]:
        self.now += after_s
        return [pulse.job_id for pulse in self.observer.silent(pulses)]


@pytest.fixture
def looks() -> Looks:
    return Looks()


def pulse(beats: int = 0, *, attempt: int = 1, cancel: bool = False, job: str = "job") -> Pulse:
    return Pulse(job, attempt, beats, cancel)


def looks_until_silent(looks: Looks, make: Callable[[], Pulse]) -> float:
    begun = looks.now + 2.0
    while not looks.look(make()):
        assert looks.now - begun < 200.0, "never"
    return looks.now - begun


def test_a_lease_runs_out_after_its_time_without_a_heartbeat(looks):
    assert looks_until_silent(looks, pulse) == 60.0


def test_each_heartbeat_begins_it_anew(looks):
    assert [looks.look(pulse(beats)) for beats in range(100) for _ in range(5)] == [[]] * 500


def test_another_attempt_is_another_lease(looks):
    for _ in range(25):
        looks.look(pulse(attempt=1))
    assert looks_until_silent(looks, lambda: pulse(attempt=2)) == 60.0


def test_an_observer_that_was_stopped_itself_saw_nothing_meanwhile(looks):
    looks.look(pulse())
    assert looks.look(pulse(), after_s=7200.0) == []
    # An hour's sleep of the machine counts as one late look, 5 s here.
    assert looks_until_silent(looks, pulse) == 60.0 - 5.0 - 2.0 + 1.0


def test_a_cancellation_that_is_not_heard_ends_sooner(looks):
    for _ in range(10):
        assert looks.look(pulse()) == []
    # Silent for 18 s when it is cancelled: 12 more are given.
    assert looks_until_silent(looks, lambda: pulse(cancel=True)) == 12.0


def test_an_outage_begins_all_anew(looks):
    for _ in range(29):
        looks.look(pulse())
    looks.observer.forget()
    assert looks_until_silent(looks, pulse) == 60.0


def test_jobs_are_told_apart(looks):
    for beats in range(30):
        assert looks.look(pulse(beats, job="alive"), pulse(job="dead")) == []
    assert looks.look(pulse(30, job="alive"), pulse(job="dead")) == ["dead"]


@pytest.fixture
def housekeeping(store, settings) -> MillHousekeeping:
    return MillHousekeeping(store, settings, threading.Event())


@pytest.mark.slow
def test_a_worker_that_could_not_write_keeps_its_job(store, settings, queue, housekeeping):
    job = queue("succeed")
    store.jobs.claim("held up")
    # Reads go on while a write lock is held: the look sees silence, and a trial write why.
    with write_lock(store.files.folder / "sawmill.db"):
        locked_until = time.monotonic() + 3.0 * settings.lease_s
        while time.monotonic() < locked_until:
            housekeeping.once()
            time.sleep(0.1)
    assert store.jobs.get(job.id).state is JobState.RUNNING
    wait_until(lambda: housekeeping.once() or store.jobs.get(job.id).state is JobState.QUEUED)


@pytest.mark.slow
def test_a_cancelled_job_of_a_dead_worker_ends_before_its_lease(store, settings, queue):
    patient = settings.model_copy(update={"lease_s": 86_400.0, "heartbeat_s": 0.3})
    housekeeping = MillHousekeeping(store, patient, threading.Event())
    job = queue("succeed")
    store.jobs.claim("dead")
    store.jobs.request_cancel(job.id)
    wait_until(lambda: housekeeping.once() or store.jobs.get(job.id).state is JobState.CANCELLED)
