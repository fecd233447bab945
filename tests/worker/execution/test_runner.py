import errno
import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import replace

import pytest
import results
from live_service import running, wait_until, write_lock
from machine_faults import at_call, database_away, refusing
from missing_parts import both_ways, fresh_by_night
from structlog.contextvars import merge_contextvars
from structlog.testing import capture_logs

from sawmill_contracts import kinds
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scans import ScanState
from sawmill_platform.attempts.process import AttemptNotStarted, AttemptProcess, FreshProcesses
from sawmill_platform.attempts.protocol import CHANNEL, Ready, to_line
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.contracts.jobs import FailureKind, JobState, Priority
from sawmill_platform.errors import StorageFull, StorageUnavailable
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.ledger.events import Actor, acting_as
from sawmill_platform.workers.poller import run_worker
from sawmill_store.store import Store

pytestmark = pytest.mark.slow


def leftovers(store):
    return [*store.files.folder.glob("attempts/*"), *store.files.folder.glob("kept/*")]


def id_of(spare):
    wait_until(lambda: spare.process_id is not None)
    return spare.process_id


@both_ways
def test_a_job_runs_in_a_process_of_its_own_and_its_files_are_published(store, runner, queue):
    first, second = queue("succeed"), queue("succeed")
    assert [runner.run_next(), runner.run_next()] == [JobState.SUCCEEDED] * 2
    made_by = [store.scans.get(job.subject_id).remarks for job in (first, second)]
    assert made_by[0] != made_by[1], "two processes"
    assert all(store.files.scan(job.subject_id).is_file() for job in (first, second))
    assert store.scans.get(first.subject_id).state is ScanState.READY
    assert leftovers(store) == []
    assert runner.run_next() is None
    assert (
        2**23 < store.events.of_job(first.id)[-1].detail["peak_memory_bytes"] < 2**32
    )  # of a Python process that has imported pydantic and SQLAlchemy: some 60 MiB


@pytest.mark.usefixtures("own_templates")
def test_every_line_about_an_attempt_names_its_job_and_who_asked_for_it(runner, queue, capfd):
    with acting_as(Actor("somebody", key_id="key-7", request_id="request-7")):
        job = queue("refuse")
    with capture_logs(processors=[merge_contextvars]) as log:
        runner.run_next()
    named = {"job_id": job.id, "kind": "ingest", "attempt": 1, "request_id": "request-7", "key_id": "key-7"}
    about = [line for line in log if line["event"] != "event"]
    assert [line["event"] for line in about] == ["attempt-started", "attempt-ended"]
    assert all(named.items() <= line.items() for line in about)
    events = [line for line in log if line["event"] == "event"]
    assert [(line["type"], line["job_id"]) for line in events] == [
        (what, job.id) for what in ("started", "failed", "scan-refused")
    ]
    (failed,) = [line for line in capfd.readouterr().err.splitlines() if "job-failed" in line]
    assert all(f"{name}={value}" in failed for name, value in named.items())


def test_a_system_without_room_for_a_spare_process_loses_no_job(start, queue):
    queue("succeed")
    runner = start(fork_attempts=False, spare_processes=2)  # for the job, and for the check of what it leaves
    runner.warm_up()
    with at_call("subprocess.Popen", refusing(errno.EAGAIN)):
        assert runner.run_next() is JobState.SUCCEEDED
        with pytest.raises(BlockingIOError):
            runner.run_next()


REFUSED = FreshProcesses(["/there/is/no/such/program"], os.environ)
BROKEN = FreshProcesses([sys.executable, "-S", "-c", "raise SystemExit(3)"], os.environ)
ASLEEP = FreshProcesses([sys.executable, "-S", "-c", "import time; time.sleep(600)"], os.environ)


class TroubledStarter:
    """A starter some of whose processes, by the number of the start, are no attempts."""

    def __init__(self, starter, troubles):
        self.starter, self.troubles = starter, troubles
        self.patience_s, self.close = starter.patience_s, starter.close
        self.started = []

    def start(self):
        number = len(self.started) + 1
        self.started.append(None)  # also where the system refuses it
        self.started[-1] = self.troubles.get(number, self.starter).start()
        return self.started[-1]


def test_a_worker_that_works_outlives_troubles_with_starting_processes(store, settings, program, queue):
    jobs, made = [queue("succeed"), queue("succeed")], []

    def lend(settings):
        made.append(TroubledStarter(program.lend(settings), {2: REFUSED, 3: BROKEN}))
        return made[-1]

    class EndsWithThem(threading.Event):
        def is_set(self):
            return super().is_set() or all(store.jobs.get(job.id).state.ended for job in jobs)

    run_worker(replace(program, lend=lend), store, settings, EndsWithThem())
    assert len(made[0].started) > 3
    assert {store.jobs.get(job.id).state for job in jobs} == {JobState.SUCCEEDED}


def test_the_end_of_a_job_is_reported_to_those_who_may_wait_for_it(store, settings, stop, starter, queue):
    ended = []
    runner = Runner(store, settings, stop, attempts=starter, on_ended=ended.append)
    first, _ = queue("refuse"), queue("fill-the-disk")
    assert [runner.run_next(), runner.run_next()] == [JobState.FAILED, JobState.QUEUED]
    assert ended == [first.id]
    runner.close()


INPUT, INVALID = FailureKind.INPUT, (FailureKind.INTERNAL, "invalid-result")
NONSENSE = ("name-a-file-outside", "keep-a-folder", "break-off", "never-end-its-line", "say-too-much")


@pytest.mark.parametrize(
    ("behaviour", "end", "words"),
    [
        ("refuse", (INPUT, "angles-missing"), "give angles_deg"),
        ("quote-a-nul", (INPUT, "angles-missing"), "the dataset 'data\ufffd' has no angles"),
        ("blunder", (FailureKind.INTERNAL, "internal-error"), "unexpected KeyError"),
        ("eat-memory", (INPUT, "out-of-memory"), "give a smaller file"),
        ("answer-nonsense", INVALID, "a defect"),
        ("leave-more", INVALID, "the files"),
        ("name-the-database", INVALID, "takes its values from other files"),
        ("keep-behind-a-file", INVALID, "scan.h5 is due"),
        *((behaviour, INVALID, "") for behaviour in NONSENSE),
    ],
)
def test_a_failure_is_reported_in_its_own_way_publishes_nothing_and_stops_no_worker(
    store, runner, queue, behaviour, end, words
):
    job, next_job = queue(behaviour), queue("succeed")
    assert [runner.run_next(), runner.run_next()] == [JobState.FAILED, JobState.SUCCEEDED]
    failure, scan = store.jobs.get(job.id).failure, store.scans.get(job.subject_id)
    assert (failure.kind, failure.code) == end
    assert words in failure.detail
    assert "secret" not in failure.detail
    assert (scan.state, scan.reason) == (ScanState.REFUSED, failure.detail)
    assert not store.files.results(job.kind, job.subject_id).exists()
    assert store.jobs.get(next_job.id).attempt == 1
    assert leftovers(store) == []


def test_a_job_that_is_killed_five_times_goes_on_where_it_was(store, runner, queue):
    job = queue("work-on-and-die")
    assert [runner.run_next() for _ in range(6)] == [*[JobState.QUEUED] * 5, JobState.SUCCEEDED]
    assert store.jobs.get(job.id).losses <= 1
    assert leftovers(store) == []


def test_checkpoints_are_no_results(store, runner, queue):
    job = queue("keep-and-succeed")
    assert runner.run_next() is JobState.SUCCEEDED
    assert [path.name for path in store.files.results(job.kind, job.subject_id).iterdir()] == ["scan.h5"]
    assert leftovers(store) == []


def test_a_result_comes_with_its_digest_and_the_lease_is_kept_while_it_is_taken(store, start, store_with, queue):
    class Looking(Jobs):
        def check_output(self, kind, result, folder):
            (pulse,) = store.jobs.pulses()
            wait_until(lambda: store.jobs.pulses()[0].beats >= pulse.beats + 3)
            return super().check_output(kind, result, folder)

    scan = queue("succeed").subject_id
    log = store.reconstructions.accept(ReconstructionRequest(scan_id=scan, theta=results.THETA, size=16))
    runner = start(on=store_with(Looking))
    assert [runner.run_next(), runner.run_next()] == [JobState.SUCCEEDED] * 2
    for path in (store.files.scan(scan), store.files.volume(log.id)):
        assert store.jobs.digest_of_result(path) == hashlib.sha256(path.read_bytes()).digest()


def test_a_file_whose_reader_loops_is_not_published_and_stops_no_worker(store, start, queue):
    job, next_job = queue("leave-an-endless-file"), queue("succeed")
    runner = start(stall_s=3)
    assert [runner.run_next(), runner.run_next()] == [JobState.FAILED, JobState.SUCCEEDED]
    failure = store.jobs.get(job.id).failure
    assert failure.code == "invalid-result"
    assert "the job left a scan.h5 that keeps its reader busy for 3 seconds" in failure.detail
    assert store.jobs.get(next_job.id).attempt == 1
    assert leftovers(store) == []


def test_a_scan_that_was_changed_is_not_read_whatever_its_time_says(store, runner, queue):
    scan_id = queue("succeed").subject_id
    assert runner.run_next() is JobState.SUCCEEDED
    path = store.files.unverified(kinds.INGEST, scan_id, "scan.h5")
    before, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    log = store.reconstructions.accept(ReconstructionRequest(scan_id=scan_id, theta=results.THETA, size=16))
    assert runner.run_next() is JobState.FAILED
    failure = store.jobs.get(log.job_id).failure
    assert (failure.kind, failure.code) == (FailureKind.INPUT, "result-damaged")


def test_a_result_is_published_once_its_process_is_gone(store, start, store_with, queue):
    job, noted = queue("answer-and-stay"), []

    class Noting(Jobs):
        """Jobs that look whether the process that has answered still runs."""

        def succeed(self, claim, result, output, **options):
            noted.append(running(int(result.remarks[0].split()[-1])))
            super().succeed(claim, result, output, **options)

    assert start(on=store_with(Noting)).run_next() is JobState.SUCCEEDED
    assert store.jobs.get(job.id).attempt == 1
    assert noted == [False]


def full_disk_at(**first):
    def refused(name):
        def call(jobs, *arguments, **options):
            if first[name]:
                first[name] -= 1
                raise StorageFull("the disk is full")
            return getattr(Jobs, name)(jobs, *arguments, **options)

        return call

    return type("FullDisk", (Jobs,), {name: refused(name) for name in first})


@pytest.mark.parametrize("behaviour", ["crash-on-a-full-disk", "blunder", "hang"])
def test_what_happens_to_a_job_on_a_full_disk_is_its_consequence(store, start, queue, full_disk, behaviour):
    job = queue(behaviour)
    full_disk(0)
    assert start(stall_s=0.6).run_next() is JobState.QUEUED
    waiting = store.jobs.get(job.id)
    assert (waiting.waiting_for.code, waiting.losses) == ("storage-full", 0)


def test_a_crash_is_final_where_the_disk_is_no_more_than_nearly_full(storage, start, queue):
    job = queue("crash-on-a-full-disk")
    with closing(Store(storage.model_copy(update={"disk_reserve_bytes": 2**62}))) as nearly_full:
        assert start(on=nearly_full).run_next() is JobState.FAILED
        assert nearly_full.jobs.get(job.id).failure.code == "broken-file"


def test_an_end_that_a_full_disk_keeps_from_being_written_is_written_later(store, start, store_with, queue):
    job, runner = queue("succeed"), start(on=store_with(full_disk_at(succeed=1, fail=2)))
    assert [runner.run_next(), runner.run_next()] == [JobState.QUEUED, JobState.SUCCEEDED]
    assert store.jobs.get(job.id).losses == 0
    assert leftovers(store) == []


def beats_missed(log):
    return [line for line in log if line["event"] == "heartbeat-missed"]


def test_a_locked_database_costs_a_running_job_nothing(store, runner, queue, in_background):
    job = queue("wait-for-leave")
    outcome = in_background(runner.run_next)
    wait_until(lambda: any(store.files.folder.glob("attempts/*/waiting")))
    with capture_logs() as log, write_lock(store.files.folder / "sawmill.db"):
        wait_until(lambda: beats_missed(log))
        (store.files.folder / "leave").touch()
        time.sleep(1.0)  # several times what is left of the attempt needs
        assert not outcome.done()
    assert outcome.result(timeout=60) is JobState.SUCCEEDED
    ended = store.jobs.get(job.id)
    assert (ended.attempt, ended.losses) == (1, 0)
    assert store.scans.get(job.subject_id).remarks[0].startswith("attempt 1")
    assert leftovers(store) == []


def test_a_worker_outlives_claims_that_cannot_be_written(
    store, store_with, settings, program, stop, queue, in_background
):
    job = queue("succeed")
    outcome = in_background(run_worker, program, store_with(full_disk_at(claim=3)), settings, stop)
    wait_until(lambda: store.jobs.get(job.id).state is JobState.SUCCEEDED or outcome.done())
    stop.set()
    outcome.result(timeout=60)
    assert store.jobs.get(job.id).state is JobState.SUCCEEDED


def test_a_cancellation_reaches_a_job_whose_heartbeats_find_the_disk_full(
    store, start, store_with, queue, in_background
):
    job, runner = queue("wait-for-leave"), start(on=store_with(full_disk_at(heartbeat=10**6)))
    outcome = in_background(runner.run_next)
    wait_until(lambda: any(store.files.folder.glob("attempts/*/waiting")))
    store.jobs.request_cancel(job.id)
    assert outcome.result(timeout=60) is JobState.CANCELLED


def test_progress_comes_out_and_a_cancellation_goes_in(store, runner, talk):
    job, outcome, process = talk(runner)
    wait_until(lambda: (seen := store.jobs.get(job.id).progress) is not None and seen.generation > 3)
    store.jobs.request_cancel(job.id)
    assert outcome.result(timeout=60) is store.jobs.get(job.id).state is JobState.CANCELLED
    assert not running(process)
    assert leftovers(store) == []


@fresh_by_night
def test_a_deaf_process_is_killed(store, runner, queue, in_background):
    job = queue("hang")
    outcome = in_background(runner.run_next)
    wait_until(lambda: store.jobs.get(job.id).state is JobState.RUNNING)
    wait_until(lambda: store.jobs.pulses()[0].beats > 1)  # they go on without progress
    store.jobs.request_cancel(job.id)
    assert outcome.result(timeout=60) is JobState.CANCELLED


@fresh_by_night
def test_a_stopping_worker_gives_its_job_back_and_takes_no_more(store, runner, stop, talk):
    job, outcome, process = talk(runner)
    stop.set()
    assert outcome.result(timeout=60) is JobState.QUEUED
    assert not running(process)
    assert runner.run_next() is None
    assert (store.jobs.get(job.id).state, store.jobs.get(job.id).attempt) == (JobState.QUEUED, 1)


def test_a_background_job_gives_way(store, runner, queue, in_background):
    example = queue("talk", priority=Priority.BACKGROUND)
    outcome = in_background(runner.run_next)
    wait_until(lambda: store.jobs.get(example.id).progress is not None)
    asked = queue("succeed")
    assert outcome.result(timeout=60) is JobState.QUEUED
    assert runner.run_next() is JobState.SUCCEEDED
    assert store.jobs.get(asked.id).state is JobState.SUCCEEDED
    assert store.jobs.get(example.id).losses == 0


def test_a_stopping_worker_lets_a_short_job_end(store, start, stop, queue, in_background):
    patient = start(stop_grace_s=600.0)
    queue("wait-for-leave")
    outcome = in_background(patient.run_next)
    wait_until(lambda: any(store.files.folder.glob("attempts/*/waiting")))
    stop.set()
    time.sleep(0.5)  # several looks at whether it is to stop
    (store.files.folder / "leave").touch()
    assert outcome.result(timeout=60) is JobState.SUCCEEDED


def test_a_lost_lease_ends_the_process_and_leaves_the_job_to_its_new_owner(store, settings, runner, talk):
    job, outcome, process = talk(runner)
    # Between a look and the taking back a heartbeat may come: then it holds.
    wait_until(lambda: store.jobs.take_back(store.jobs.pulses()[0], retries=settings.retries) is not None)
    new_owner = store.jobs.claim("other")
    assert outcome.result(timeout=60) is None
    assert not running(process)
    assert store.jobs.heartbeat(new_owner) is False
    assert store.jobs.get(job.id).attempt == 2


@fresh_by_night
def test_threads_share_a_runner(runner, queue, settings):
    jobs = 6 if settings.fork_attempts else 3  # a fresh process takes a second
    for _ in range(jobs):
        queue("succeed")
    with ThreadPoolExecutor(3) as pool:
        states = list(pool.map(lambda _: runner.run_next(), range(jobs)))
    assert states == [JobState.SUCCEEDED] * jobs


def test_a_job_runs_in_the_process_that_was_warm_before_it_came(store, runner, starter, queue):
    queue("succeed")
    runner.run_next()
    warm = id_of(starter.started[-1])
    job = queue("succeed")
    runner.run_next()
    assert store.scans.get(job.subject_id).remarks[0].endswith(f"process {warm}")


@fresh_by_night
def test_a_spare_that_died_is_replaced(runner, starter, queue):
    assert runner.run_next() is None
    (spare,) = starter.started
    os.kill(id_of(spare), signal.SIGKILL)
    wait_until(lambda: not spare.alive)  # until then it may still be taken for a running one
    queue("succeed")
    assert runner.run_next() is JobState.SUCCEEDED


@fresh_by_night
def test_a_spare_that_does_not_get_ready_is_replaced(store, start, attempts, settings, queue):
    starter = TroubledStarter(attempts(settings), {1: ASLEEP})
    runner = start(starter=starter, start_timeout_s=1.0)
    runner.warm_up()
    (spare,) = starter.started
    job = queue("succeed")
    assert runner.run_next() is JobState.SUCCEEDED
    assert not spare.alive
    assert store.jobs.get(job.id).attempt == 1


class Undying:
    """A process in the system's own hands, as when it waits for a disk."""

    stdin, pid = None, None

    def poll(self):
        return None

    def wait(self, timeout=None):
        assert timeout is not None, "for ever"
        raise subprocess.TimeoutExpired("attempt", timeout)


def test_an_attempt_whose_supervisor_was_killed_ends_without_a_word(command):
    reading, writing = os.pipe()
    os.close(reading)
    given = {"env": {**os.environ, CHANNEL: str(writing)}, "pass_fds": [writing], "stdin": subprocess.DEVNULL}
    ended = subprocess.run(command, **given, capture_output=True, text=True, timeout=60, check=False)
    os.close(writing)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


def test_nobody_waits_for_a_process_that_cannot_be_killed():
    reading, writing = os.pipe()
    os.close(writing)
    assert AttemptProcess(Undying(), reading, undying_s=0.1).end(0.1) == -signal.SIGKILL


@pytest.mark.usefixtures("own_templates")
@pytest.mark.parametrize("script", ["raise SystemExit(3)", "import time; time.sleep(60)"])
def test_a_broken_installation_uses_up_no_attempts(store, settings, start, attempts, queue, script):
    job = queue("succeed")
    runner = start(starter=attempts(settings, [sys.executable, "-c", script]), start_timeout_s=0.5)
    with pytest.raises(AttemptNotStarted):
        runner.run_next()
    assert store.jobs.get(job.id).attempt == 0


# As a compiler does that other processes leave little of the machine: ready long after the limit.
BUSY_NOW_AND_THEN = f"""
import os, time
for round in range(10):
    until = time.process_time() + 0.02
    while time.process_time() < until:
        pass
    time.sleep(0.2)
os.write(int(os.environ["{CHANNEL}"]), {to_line(Ready())!r})
time.sleep(60)
"""


def test_a_start_that_goes_on_working_is_not_ended_by_its_limit():
    started = FreshProcesses([sys.executable, "-S", "-c", BUSY_NOW_AND_THEN], os.environ).start()
    started.wait_until_ready(0.5)
    started.end(60)


def test_a_failing_database_is_survived_by_a_running_job(store, runner, queue, in_background):
    job = queue("talk")
    outcome = in_background(runner.run_next)
    wait_until(lambda: store.jobs.get(job.id).progress is not None)
    with capture_logs() as log, database_away(store.database):
        wait_until(lambda: beats_missed(log))
        time.sleep(1.0)  # several heartbeats more, which are missed for the same reason
    assert len(beats_missed(log)) == 1

    def asked():
        with suppress(StorageUnavailable):
            return store.jobs.request_cancel(job.id)

    wait_until(asked)
    assert outcome.result(timeout=60) is JobState.CANCELLED
