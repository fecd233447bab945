"""Attempts that hang and leases that run out: time is counted by the observer's own monotonic clock."""

import threading
import time
from collections.abc import Callable

import pytest
from live_service import running, wait_until, write_lock

from sawmill_contracts import kinds
from sawmill_platform.attempts.failures import duration
from sawmill_platform.attempts.patience import LATE_S, LeaseObserver, Patience
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobKind, JobState
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.jobs.job_store import Pulse
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_vocabulary import Progress
from sawmill_worker.housekeeping import MillHousekeeping


class Waiting:
    """A supervisor's patience with a calibration, or with a reader that has a share of a core, one look a second."""

    def __init__(
        self, *, begun: bool = True, upload_bytes: int | None = None, busy: float = 0.0, **settings: float
    ) -> None:
        self.now, self.busy = 1000.0, busy
        asked = ExecutionSettings(progress_s=1.0, broker_url=None, **settings)
        kind = kinds.CALIBRATE if upload_bytes is None else kinds.INGEST
        self.patience = Patience(kind, asked, upload_bytes=upload_bytes, monotonic=lambda: self.now)
        if begun:
            self.patience.moved()

    def end(self) -> Failure | None:
        return self.patience.end(self.busy * self.now)

    def until_ended(self, said: Progress | None = None, *, most_s: float = 200_000.0) -> float:
        begun = self.now
        while self.now - begun < most_s:
            if said is not None:
                self.patience.heard(said)
            self.now += 1.0
            if self.end() is not None:
                return self.now - begun
        raise AssertionError("never")


def test_silence_ends_an_attempt_after_its_kinds_time():
    assert Waiting().until_ended() == declaration_of(kinds.CALIBRATE).stall_s


@pytest.mark.parametrize(
    ("upload_bytes", "busy", "seconds"),
    [
        (10_000, 1.0, 60.0),
        (10_000, 0.55, 60.0),  # as where others keep the cores busy
        (10_000, 0.25, 120.0),
        (10_000, 4.0, 60.0),
        (100 * 2**20, 1.0, 160.0),
        (2**40, 1.0, 1800.0),
        (10_000, 0.0, 1800.0),  # as while a disk is away
    ],
)
def test_a_reader_that_is_busy_without_progress_has_a_minute_and_time_by_the_size(upload_bytes, busy, seconds):
    waiting = Waiting(upload_bytes=upload_bytes, busy=busy)
    assert waiting.until_ended() == pytest.approx(seconds, abs=2.0)
    failure = waiting.end()
    expected = (FailureKind.INPUT, "broken-file") if busy else (FailureKind.PASSING, "attempt-stalled")
    assert (failure.kind, failure.code) == expected


def test_a_reader_that_makes_progress_may_be_busy():
    waiting = Waiting(upload_bytes=10_000, busy=1.0)
    for step in range(1, 10):
        with pytest.raises(AssertionError, match="never"):
            waiting.until_ended(Progress(fraction=step / 10, stage="prepare"), most_s=50.0)


def test_a_process_that_does_not_begin_or_repeats_the_same_report_has_a_minute():
    waiting = Waiting(begun=False)
    assert waiting.until_ended() == 60.0
    failure = waiting.end()
    assert (failure.kind, failure.code) == (FailureKind.PASSING, "attempt-stalled")
    assert failure.detail.startswith("the job's process sent nothing for 60 seconds after it was given the job")
    assert Waiting(stall_s=60).until_ended(Progress(fraction=0.5, stage="search", best_value=-1.0)) == 60.0


@pytest.mark.parametrize(
    "further",
    [
        Progress(fraction=0.500001, stage="search", generation=3),
        Progress(fraction=0.5, stage="result", generation=3),
        Progress(fraction=0.5, stage="search", generation=4),
    ],
)
def test_a_fraction_a_stage_or_a_generation_further_begins_anew(further):
    waiting = Waiting(stall_s=60)
    waiting.patience.heard(Progress(fraction=0.5, stage="search", generation=3))
    with pytest.raises(AssertionError, match="never"):
        waiting.until_ended(most_s=59.0)
    waiting.patience.heard(further)
    assert waiting.until_ended() == 60.0


def test_time_in_which_the_supervisor_was_stopped_does_not_count():
    waiting = Waiting(stall_s=60, time_limit_s=600)
    for _ in range(8):  # an hour each: a late look, 7 s here
        waiting.now += 3600.0
        assert waiting.end() is None
    assert waiting.until_ended() == 60.0 - 8 * (LATE_S + 2.0)


def test_moving_on_does_not_help_beyond_the_time_limit():
    waiting = Waiting(time_limit_s=600)
    for step in range(599):
        waiting.patience.heard(Progress(fraction=step / 1000, stage="search"))
        waiting.now += 1.0
        assert waiting.end() is None
    waiting.now += 1.0
    beyond = waiting.end()
    assert (beyond.kind, beyond.code) == (FailureKind.INPUT, "too-long")
    assert "more than the 10 minutes that it may take: ask for fewer" in beyond.detail


@pytest.mark.parametrize(("seconds", "words"), [(90.2, "90.2 seconds"), (1800, "30 minutes"), (86_400, "24 hours")])
def test_a_time_is_said_in_a_fitting_unit(seconds, words):
    assert duration(seconds) == words


@pytest.mark.parametrize("kind", JobKind.all())
def test_limits_of_every_kind_follow_each_other(kind):
    declared = declaration_of(kind)
    assert 600 <= declared.stall_s <= declared.time_limit_s / 4


def fates(store, job):
    return [event.type for event in store.events.of_job(job.id) if event.type is not event_kinds.STARTED]


@pytest.mark.slow
def test_an_attempt_that_hangs_is_a_loss_and_the_third_is_final(store, start, queue):
    job = queue("repeat")
    runner = start(stall_s=0.6)
    assert [runner.run_next() for _ in range(3)] == [JobState.QUEUED, JobState.QUEUED, JobState.FAILED]
    failure = store.jobs.get(job.id).failure
    assert (failure.kind, failure.code) == (FailureKind.PASSING, "attempt-stalled")
    assert "nothing moved for 0.6" in failure.detail
    assert "in the stage 'search', and its process was ended" in failure.detail
    assert fates(store, job) == [event_kinds.LOST] * 3 + [event_kinds.FAILED]
    assert store.events.of_job(job.id)[1].detail["code"] == "attempt-stalled"
    assert list((store.files.folder / "attempts").iterdir()) == []


@pytest.mark.slow
def test_a_file_whose_reader_loops_fails_once_and_the_next_one_does_not_wait(store, start, queue):
    job, honest = queue("loop"), queue("succeed")
    runner = start(stall_s=1)
    assert [runner.run_next(), runner.run_next()] == [JobState.FAILED, JobState.SUCCEEDED]
    failure = store.jobs.get(job.id).failure
    assert (failure.kind, failure.code) == (FailureKind.INPUT, "broken-file")
    assert "reading the file did not get on for" in failure.detail
    assert (store.jobs.get(job.id).losses, fates(store, job)) == (0, [event_kinds.FAILED])
    assert store.jobs.get(honest.id).attempt == 1


@pytest.mark.slow
def test_a_job_that_hung_once_is_done(store, start, queue):
    job = queue("hang-once")
    runner = start(stall_s=1)
    assert [runner.run_next(), runner.run_next()] == [JobState.QUEUED, JobState.SUCCEEDED]
    assert "in the stage 'prepare'" in store.events.of_job(job.id)[1].detail["detail"]


@pytest.mark.slow
def test_a_stopped_process_is_ended(store, start, queue, in_background):
    job = queue("freeze")
    outcome = in_background(start(stall_s=1).run_next)
    wait_until(lambda: any(store.files.folder.glob("attempts/*/pid")))
    stopped = int(next(store.files.folder.glob("attempts/*/pid")).read_text())
    assert outcome.result(timeout=60) is JobState.QUEUED
    assert store.jobs.get(job.id).waiting_for.code == "attempt-stalled"
    assert not running(stopped)


def test_an_attempt_that_never_said_a_word_hung_before_its_first_stage():
    waiting = Waiting()
    waiting.until_ended()
    assert "nothing moved for 30 minutes before its first stage" in waiting.end().detail


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


@pytest.mark.slow
def test_a_worker_that_could_not_write_keeps_its_job(store, settings, queue):
    housekeeping = MillHousekeeping(store, settings, threading.Event())
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
