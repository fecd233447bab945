import errno
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from live_service import descendants, running, wait_until
from machine_faults import at_call, refusing
from structlog.testing import capture_logs

from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.program import environment_with
from sawmill_platform.workers.supervise import WatchedWorker, WorkerSupervisor

pytestmark = pytest.mark.slow

IDLE = [sys.executable, "-c", "import os; os.read(0, 1)"]
WORKER = [sys.executable, str(Path(__file__).with_name("fake_worker.py"))]
# Named so that it reaches attempts: of the environment they have what Python looks at.
MARK = "PYTHON_MARK_OF_A_TEST"


@pytest.fixture
def supervisor(storage, settings):
    with WorkerSupervisor(storage, settings.model_copy(update={"workers": 2}), command=WORKER) as running:
        yield running


def test_waking_workers_that_have_ended_does_no_harm(storage, settings):
    with WorkerSupervisor(storage, settings, command=[sys.executable, "-c", ""]) as supervisor:
        for _ in range(200):
            supervisor.wake("nothing")
    supervisor.wake("nothing")


@pytest.fixture(autouse=True)
def mark(storage: StorageSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the data folder, which an attempt's environment does not name."""
    monkeypatch.setenv(MARK, str(storage.data_folder))


def processes_of(folder: Path) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            with suppress(OSError):
                if f"{MARK}={folder}".encode() in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
    return found


def test_a_short_job_waits_for_no_long_one(store, storage, settings, queue):
    lane = {"command": WORKER, "held_up": store.jobs.short_job_is_held_up}
    with WorkerSupervisor(storage, settings, **lane) as supervisor:
        long = queue("talk", short=False)
        wait_until(lambda: store.jobs.get(long.id).state is JobState.RUNNING)
        time.sleep(0.5)
        assert len(process_ids(supervisor)) == 1, "no lane is open while nobody needs it"
        for _ in range(2):
            short = [queue("succeed") for _ in range(2)]
            supervisor.wake(short[0].id)
            wait_until(lambda jobs=short: all(store.jobs.get(job.id).state is JobState.SUCCEEDED for job in jobs))
            assert store.jobs.get(long.id).state is JobState.RUNNING
            wait_until(lambda: len(process_ids(supervisor)) == 1)  # it has ended by itself, and opens again
    assert processes_of(storage.data_folder) == []


def test_jobs_run_without_a_wake_up_and_again_when_their_worker_was_killed_and_replaced(store, supervisor, queue):
    jobs = [queue("succeed") for _ in range(4)]
    wait_until(lambda: all(store.jobs.get(job.id).state is JobState.SUCCEEDED for job in jobs))
    job = queue("talk")
    wait_until(lambda: any(store.files.folder.glob(f"attempts/{job.id}*/pid")))
    victim = int(store.jobs.get(job.id).worker.rpartition("-")[2])
    assert victim in process_ids(supervisor)
    family = descendants(victim)
    assert int(next(store.files.folder.glob(f"attempts/{job.id}*/pid")).read_text()) in family
    os.kill(victim, signal.SIGKILL)
    wait_until(lambda: not any(map(running, family)))  # the template and all attempts, the spare one too
    wait_until(lambda: store.jobs.get(job.id).attempt == 2)
    wait_until(lambda: len(process_ids(supervisor)) == 2)
    assert victim not in process_ids(supervisor)


def test_a_busy_worker_reports_that_it_works_is_woken_for_the_next_job_and_gives_its_job_back_when_it_is_left(
    store, storage, settings, queue
):
    first = queue("talk")
    with WorkerSupervisor(storage, settings.model_copy(update={"poll_s": 600.0}), command=WORKER) as supervisor:
        wait_until(lambda: heard(supervisor))  # that its worker works, before the first job has ended
        store.jobs.request_cancel(first.id)
        wait_until(lambda: store.jobs.get(first.id).state is JobState.CANCELLED)
        for _ in range(2):  # it may still look for the first one by itself
            job = queue("succeed")
            supervisor.wake(job.id)
            wait_until(lambda job=job: store.jobs.get(job.id).state is JobState.SUCCEEDED)
        last = queue("talk")
        supervisor.wake(last.id)
        wait_until(lambda: store.jobs.get(last.id).progress is not None)
    assert store.jobs.get(last.id).state is JobState.QUEUED
    assert processes_of(storage.data_folder) == []


def test_nothing_is_left_when_the_service_is_killed(store, storage, settings, queue):
    program = (
        "import sys, time; from sawmill_platform.workers.supervise import WorkerSupervisor;"
        "from sawmill_platform.workers.settings import ExecutionSettings;"
        "from sawmill_platform.settings import StorageSettings;"
        f"WorkerSupervisor(StorageSettings(), ExecutionSettings(), command={WORKER!r}).__enter__(); time.sleep(600)"
    )
    service = subprocess.Popen([sys.executable, "-c", program], env=environment_with(storage, settings))
    job = queue("talk")
    wait_until(lambda: store.jobs.get(job.id).progress is not None)
    assert len(processes_of(storage.data_folder)) >= 3
    service.kill()
    service.wait()
    wait_until(lambda: processes_of(storage.data_folder) == [])
    assert store.jobs.get(job.id).state is JobState.QUEUED


def test_a_worker_that_cannot_start_is_tried_again_ever_more_slowly(storage, settings):
    now_s = [0.0]
    worker = WatchedWorker([sys.executable, "-c", ""], environment_with(storage, settings), monotonic=lambda: now_s[-1])
    worker.start()
    for wait_s in (0.5, 1.0, 2.0):
        ended = worker.process
        ended.wait(60)
        worker.restart_if_due()
        for later_s, restarted in ((wait_s - 0.01, False), (0.01, True)):
            now_s.append(now_s[-1] + later_s)
            worker.restart_if_due()
            assert (worker.process is not ended) is restarted
    worker.end(60)


def process_ids(supervisor: WorkerSupervisor) -> list[int]:
    return [worker.process.pid for worker in supervisor._workers if worker.is_running]


def heard(supervisor: WorkerSupervisor) -> bool:
    with suppress(BlockingIOError):
        return bool(supervisor._workers[0]._line.recv(1, socket.MSG_PEEK))
    return False


def restarts(log):
    return [(entry["event"], entry.get("restart_in_s")) for entry in log if entry["event"] != "run-as-root"]


def test_a_worker_that_had_worked_is_replaced_soon_however_often_it_is_killed(storage, settings):
    able = [sys.executable, "-c", "import os, time; os.write(0, bytes(1)); time.sleep(600)"]
    with capture_logs() as log, WorkerSupervisor(storage, settings, command=able) as supervisor:
        for _ in range(3):
            wait_until(lambda: process_ids(supervisor))
            victim = process_ids(supervisor)[0]
            wait_until(lambda: heard(supervisor))
            os.kill(victim, signal.SIGKILL)
            wait_until(lambda victim=victim: process_ids(supervisor) not in ([], [victim]))
    assert restarts(log) == [("worker-ended", 0.5)] * 3


def test_a_system_that_cannot_start_a_process_is_asked_again(storage, settings):
    refuse_twice = at_call("subprocess.Popen", refusing(errno.EAGAIN, times=2))
    with capture_logs() as log, refuse_twice, WorkerSupervisor(storage, settings, command=IDLE) as supervisor:
        wait_until(lambda: process_ids(supervisor))
    assert restarts(log) == [("worker-not-started", 0.5), ("worker-not-started", 1.0)]


def test_workers_are_watched_whatever_happens(storage, settings):
    def stumble(_):
        raise MemoryError

    broken = [sys.executable, "-c", ""]
    with capture_logs() as log, WorkerSupervisor(storage, settings, command=broken):
        with at_call("subprocess.Popen", stumble):
            wait_until(lambda: [event for event, _ in restarts(log)].count("worker-not-watched") > 1)
        seen = len(log)
        wait_until(lambda: len(log) > seen)
    assert {event for event, _ in restarts(log)} == {"worker-ended", "worker-not-watched"}
