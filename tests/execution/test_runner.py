import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from worker.contracts.jobs import FailureKind, JobState
from worker.contracts.scans import ScanState
from worker.execution.process import AttemptNotStarted
from worker.execution.runner import Runner
from worker.storage.errors import StorageUnavailable
from worker.storage.jobs import Jobs


@pytest.fixture
def stop():
    return threading.Event()


@pytest.fixture
def runner(store, settings, stop, command):
    made = Runner(store, settings, stop, command=command)
    yield made
    made.close()


@pytest.fixture
def in_background():
    with ThreadPoolExecutor(4) as pool:
        yield pool.submit


def leftovers(store):
    return list((store.files.folder / "attempts").iterdir())


def test_a_job_runs_in_a_process_of_its_own_and_its_files_are_published(store, runner, queue):
    first, second = queue("succeed"), queue("succeed")
    assert [runner.run_next(), runner.run_next()] == [JobState.SUCCEEDED] * 2
    scans = [store.files.scan(job.subject_id).read_text() for job in (first, second)]
    assert scans[0] != scans[1], "two processes"
    assert store.scans.get(first.subject_id).state is ScanState.READY
    assert leftovers(store) == []
    assert runner.run_next() is None


def test_only_the_named_job_is_run(store, runner, queue):
    first, second = queue("succeed"), queue("succeed")
    assert runner.run_next(second.id) is JobState.SUCCEEDED
    assert store.jobs.get(first.id).state is JobState.QUEUED


@pytest.mark.parametrize(
    ("behaviour", "kind", "code", "words"),
    [
        ("refuse", FailureKind.INPUT, "angles-missing", "give angles_deg"),
        ("blunder", FailureKind.INTERNAL, "internal-error", "unexpected KeyError"),
        ("eat-memory", FailureKind.INPUT, "out-of-memory", "ask for fewer rows"),
        ("answer-nonsense", FailureKind.INTERNAL, "invalid-result", "a defect"),
    ],
)
def test_a_failure_is_told_in_its_own_way(store, runner, queue, behaviour, kind, code, words):
    job = queue(behaviour)
    assert runner.run_next() is JobState.FAILED
    failure = store.jobs.get(job.id).failure
    assert (failure.kind, failure.code) == (kind, code)
    assert words in failure.detail
    assert "secret" not in failure.detail
    assert store.scans.get(job.subject_id).reason == failure.detail
    assert leftovers(store) == []


@pytest.mark.parametrize(("behaviour", "code"), [("end-by-sigkill", "attempt-died"), ("fill-the-disk", "storage-full")])
def test_a_passing_failure_is_tried_three_times(store, runner, queue, behaviour, code):
    job = queue(behaviour)
    assert [runner.run_next() for _ in range(4)] == [JobState.QUEUED, JobState.QUEUED, JobState.FAILED, None]
    assert store.jobs.get(job.id).failure.code == code
    assert leftovers(store) == []


def test_what_passes_does_not_come_back(store, runner, queue):
    job = queue("stumble")
    assert [runner.run_next(), runner.run_next()] == [JobState.QUEUED, JobState.SUCCEEDED]
    assert store.files.scan(job.subject_id).read_text().startswith("attempt 2")


def test_progress_comes_out_and_a_cancellation_goes_in(store, runner, queue, in_background, wait_for, is_running):
    job = queue("talk")
    outcome = in_background(runner.run_next)
    wait_for(lambda: (seen := store.jobs.get(job.id).progress) is not None and seen.generation > 3)
    pid = int(next(store.files.folder.glob("attempts/*/pid")).read_text())
    store.jobs.request_cancel(job.id)
    assert outcome.result(timeout=10) is JobState.CANCELLED
    assert store.jobs.get(job.id).state is JobState.CANCELLED
    assert not is_running(pid)
    assert leftovers(store) == []


def test_a_deaf_process_is_killed(store, runner, queue, in_background, wait_for):
    job = queue("hang")
    outcome = in_background(runner.run_next)
    wait_for(lambda: store.jobs.get(job.id).state is JobState.RUNNING)
    time.sleep(2.5)
    assert store.jobs.requeue_expired() == [], "heartbeats go on without progress"
    store.jobs.request_cancel(job.id)
    assert outcome.result(timeout=10) is JobState.CANCELLED


def test_a_stopping_worker_gives_its_job_back(store, runner, stop, queue, in_background, wait_for, is_running):
    job = queue("talk")
    outcome = in_background(runner.run_next)
    wait_for(lambda: any(store.files.folder.glob("attempts/*/pid")))
    pid = int(next(store.files.folder.glob("attempts/*/pid")).read_text())
    stop.set()
    assert outcome.result(timeout=10) is JobState.QUEUED
    assert store.jobs.get(job.id).state is JobState.QUEUED
    assert not is_running(pid)


def test_a_stopping_worker_lets_a_short_job_end(store, runner, stop, queue, in_background, wait_for):
    job = queue("pause")
    outcome = in_background(runner.run_next)
    wait_for(lambda: store.jobs.get(job.id).state is JobState.RUNNING)
    stop.set()
    assert outcome.result(timeout=10) is JobState.SUCCEEDED


def test_a_lost_lease_ends_the_process_and_leaves_the_job_to_its_new_owner(
    store, runner, queue, in_background, wait_for, is_running
):
    job = queue("talk")
    outcome = in_background(runner.run_next)
    wait_for(lambda: any(store.files.folder.glob("attempts/*/pid")))
    pid = int(next(store.files.folder.glob("attempts/*/pid")).read_text())
    with store._database.write() as session:
        session.connection().exec_driver_sql("UPDATE jobs SET lease_expires_s = 0")
    assert len(store.jobs.requeue_expired()) == 1
    new_owner = store.jobs.claim("other", lease_s=60)
    assert outcome.result(timeout=10) is None
    assert not is_running(pid)
    assert store.jobs.heartbeat(new_owner, lease_s=60) is False
    assert store.jobs.get(job.id).attempt == 2


def test_threads_share_a_runner(runner, queue):
    jobs = [queue("succeed") for _ in range(6)]
    with ThreadPoolExecutor(3) as pool:
        states = list(pool.map(lambda job: runner.run_next(job.id), jobs))
    assert states == [JobState.SUCCEEDED] * 6


def test_a_job_runs_in_the_process_that_was_warm_before_it_came(store, runner, queue):
    queue("succeed")
    runner.run_next()
    (spare,) = runner._spares
    job = queue("succeed")
    runner.run_next()
    assert store.files.scan(job.subject_id).read_text().endswith(f"process {spare._process.pid}")


def test_a_stopping_worker_takes_no_more_jobs(store, runner, stop, queue):
    job = queue("succeed")
    stop.set()
    assert runner.run_next(job.id) is None
    assert store.jobs.get(job.id).attempt == 0


def test_a_spare_that_died_is_replaced(runner, queue):
    assert runner.run_next() is None
    runner._spares[0]._process.kill()
    runner._spares[0]._process.wait()
    queue("succeed")
    assert runner.run_next() is JobState.SUCCEEDED


@pytest.mark.parametrize("program", ["raise SystemExit(3)", "import time; time.sleep(60)"])
def test_a_broken_installation_uses_up_no_attempts(store, settings, stop, queue, program):
    job = queue("succeed")
    impatient = settings.model_copy(update={"start_timeout_s": 0.5})
    runner = Runner(store, impatient, stop, command=[sys.executable, "-c", program])
    with pytest.raises(AttemptNotStarted):
        runner.run_next()
    assert store.jobs.get(job.id).attempt == 0
    runner.close()


def test_a_failing_database_is_survived_by_a_running_job(store, runner, queue, in_background, wait_for, monkeypatch):
    job = queue("talk")
    outcome = in_background(runner.run_next)
    wait_for(lambda: store.jobs.get(job.id).progress is not None)
    beats = []

    def heartbeat(self, *arguments, **options):
        beats.append(1)
        if len(beats) < 3:
            raise StorageUnavailable("the database does not answer: away")
        return original(self, *arguments, **options)

    original = Jobs.heartbeat
    monkeypatch.setattr(Jobs, "heartbeat", heartbeat)
    wait_for(lambda: len(beats) > 3)
    store.jobs.request_cancel(job.id)
    assert outcome.result(timeout=10) is JobState.CANCELLED
