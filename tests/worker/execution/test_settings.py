"""Settings from the environment to workers and attempts, and their shares of the cores."""

import json
import os
import re
import signal
from pathlib import Path

import pytest
from missing_parts import fresh_by_night
from pydantic import ValidationError
from results import SCANNER_SPEC
from structlog.testing import capture_logs

from sawmill_contracts import kinds
from sawmill_contracts.phantoms import PhantomDrawing, PhantomPicture
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.attempts.failures import died
from sawmill_platform.attempts.limits import DATA_BYTES, FILE_BYTES, cores, limits_of
from sawmill_platform.contracts.jobs import FailureKind, JobKind, JobState
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers import program, settings
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_service.settings import ServiceSettings
from sawmill_vocabulary import Disc, Theta

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]


def test_settings_survive_the_way_through_an_environment(monkeypatch):
    sent = ExecutionSettings(lease_s=7, heartbeat_s=1.5, workers=3, broker_url=None, log_format="json")
    stored = StorageSettings(data_folder=Path("/srv/data"), watch_folders=[Path("/srv/a b"), Path("/srv/c'd")])
    monkeypatch.setenv("SAWMILL_BROKER_URL", "redis://elsewhere")
    environment = program.environment_with(stored, sent)
    for name in [name for name in environment if name.startswith("SAWMILL_")] + ["SAWMILL_BROKER_URL"]:
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert (ExecutionSettings(), StorageSettings()) == (sent, stored)


def test_the_service_s_token_stays_with_the_service(monkeypatch):
    monkeypatch.setenv("SAWMILL_TOKEN", "t" * 32)
    monkeypatch.setenv("SAWMILL_TOKEN_FILE", "/run/secrets/token")
    assert not {"SAWMILL_TOKEN", "SAWMILL_TOKEN_FILE"} & set(program.environment_with(ExecutionSettings()))


def test_attempts_have_no_secret_in_their_environment(monkeypatch):
    ours = ("SAWMILL_TOKEN", "SAWMILL_TOKEN_FILE", "SAWMILL_DATABASE_URL", "SAWMILL_BROKER_URL")
    for name in (*ours, "PGPASSWORD", "AWS_SECRET_ACCESS_KEY", "ANYTHING_ELSE"):
        monkeypatch.setenv(name, "redis://:canary@broker/0")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/var/cache/sawmill")
    environment = program.environment_of_attempts(ExecutionSettings(lease_s=77))
    assert "canary" not in "".join(environment.values())
    assert (environment["NUMBA_CACHE_DIR"], environment["SAWMILL_LEASE_S"]) == ("/var/cache/sawmill", "77.0")


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("SAWMILL_LEASE", "SAWMILL_LEASE is no setting: did you mean SAWMILL_LEASE_S?"),
        ("sawmill_brokerurl", "sawmill_brokerurl is no setting: did you mean SAWMILL_BROKER_URL?"),
        ("SAWMILL_XYZZY", "SAWMILL_XYZZY is no setting: unset it; docs/look-up/settings.md lists the settings"),
    ],
)
def test_a_misspelt_setting_is_refused_with_the_nearest_one(name, complaint):
    with pytest.raises(settings.WrongVariableError) as refused:
        settings.check_variables({name: "30", "PATH": "/bin", "SAWMILL_PORT": "80"})
    assert str(refused.value) == complaint


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("SAWMILL_LEASE_S", "long", "SAWMILL_LEASE_S: Input should be a valid number"),
        ("SAWMILL_LEASE_S", "15", r"lease_s must be at least twice heartbeat_s \(10.0\), not 15.0"),
        ("SAWMILL_LEASE", "15", "SAWMILL_LEASE is no setting"),
    ],
)
def test_a_setting_that_cannot_be_is_refused_in_one_sentence(monkeypatch, name, value, sentence):
    monkeypatch.setenv(name, value)
    with pytest.raises(settings.WrongVariableError, match=sentence) as refused, settings.variables_checked():
        ExecutionSettings()
    assert "\n" not in str(refused.value)


def test_the_service_s_settings_are_known_to_workers():
    assert {f"SAWMILL_{name.upper()}" for name in ServiceSettings.model_fields} == settings.OF_THE_SERVICE


def test_every_variable_that_the_product_names_is_known():
    assert {
        name
        for folder in ("service", "worker")
        for path in (ROOT / folder).rglob("*.py")
        for name in re.findall(r"\bSAWMILL_[A-Z_]+[A-Z]\b", path.read_text())
    } <= settings.KNOWN
    settings.check_variables(dict.fromkeys(settings.KNOWN, ""))


@pytest.mark.parametrize("url", ["redis://:a[b@host/0", "redis://:a#b@host/0", "redis://:a/b@host:6379/0", "host"])
def test_an_address_of_the_broker_that_cannot_be_read_is_refused_without_the_password(url):
    with pytest.raises(ValidationError, match="write # as %23") as refusal:
        ExecutionSettings(broker_url=url)
    assert "a#b" not in refusal.value.errors()[0]["msg"]


@pytest.mark.parametrize("url", ["redis://host", "rediss://user:a%23b@[::1]:6379/0", "redis+socket:///run/redis.sock"])
def test_an_address_of_the_broker_that_can_be_read_is_kept(url):
    assert ExecutionSettings(broker_url=url).broker_url == url


def asked(workers, threads=None):
    return ExecutionSettings(workers=workers, numba_num_threads=threads, broker_url=None)


@pytest.mark.parametrize(("workers", "threads"), [(1, 8), (2, 4), (3, 2), (8, 1), (20, 1)])
def test_each_worker_has_its_share_of_the_cores(workers, threads):
    assert program.threads_each(asked(workers), {}, on_cores=8) == threads
    assert workers * threads <= max(8, workers)


def test_what_somebody_asked_for_is_kept():
    assert program.threads_each(asked(4, 6), {"NUMBA_NUM_THREADS": "3"}, on_cores=8) == 6
    assert program.threads_each(asked(4), {"NUMBA_NUM_THREADS": "3"}, on_cores=8) == 3


@pytest.mark.parametrize(
    ("workers", "threads", "said"),
    [
        (1, None, []),
        (4, None, []),
        (4, 2, []),
        (4, 3, ["more-threads-than-cores"]),
        (9, None, ["more-workers-than-cores"]),
    ],
)
def test_more_threads_than_cores_are_said(monkeypatch, workers, threads, said):
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with capture_logs() as log:
        program.say_if_crowded(asked(workers, threads), on_cores=8)
    assert [entry["event"] for entry in log] == said


def test_attempts_get_their_share_for_kernels_and_one_thread_for_linear_algebra(store, monkeypatch):
    for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    environment = program.attempt_environment(store, asked(2))
    share = str(max(1, cores() // 2))
    assert [environment[name] for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS")] == [share, "1"]
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    assert program.attempt_environment(store, asked(2))["OPENBLAS_NUM_THREADS"] == "3"


THETA = Theta(0.0, 700.0, 0.0, 0.0, 0.0)
CRASHES = [signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT]
SCANNER = ScannerSpec.model_validate(SCANNER_SPEC)


@pytest.mark.parametrize("number", CRASHES)
def test_no_crash_is_tried_again(number):
    for kind in JobKind.all():
        failure = died(-number, kind)
        if kind in {kinds.INGEST, kinds.INSPECT, kinds.TRACE_PHANTOM}:
            assert (failure.kind, failure.code) == (FailureKind.INPUT, "broken-file")
        else:
            assert (failure.kind, failure.code) == (FailureKind.INTERNAL, "attempt-crashed")
        assert f"({number.name})" in failure.detail


@fresh_by_night
def test_an_upload_that_crashes_its_reader_is_refused_once(store, start, queue):
    runner = start()
    for crash in ("SIGSEGV", "SIGBUS"):
        job = queue(f"end-by-{crash.lower()}")
        assert runner.run_next() is JobState.FAILED
        failure = store.jobs.get(job.id).failure
        assert failure.code == "broken-file"
        assert f"reading the file crashed the reader ({crash})" in failure.detail
        assert store.scans.get(job.subject_id).reason == failure.detail
    received = store.files.receive([b"end-by-sigabrt"], max_bytes=100)
    phantom = store.phantoms.accept_picture(PhantomPicture(name="ell", width_mm=400), received)
    assert runner.run_next() is JobState.FAILED
    assert "reading the picture crashed the reader (SIGABRT)" in store.phantoms.get(phantom.id).reason


def test_a_crash_that_no_file_is_to_blame_for_is_a_defect_reported_once(store, start):
    ask = PlanRequest(scanner_id=store.scanners.create(SCANNER).id, theta=THETA)
    runner = start()
    for crash in ("SIGSEGV", "SIGFPE", "SIGILL"):
        body = PhantomDrawing(name=f"end-by-{crash.lower()}", shapes=[Disc(center_mm=(0, 0), radius_mm=50)])
        plan = store.plans.accept(ask, given={"phantom_id": store.phantoms.create(body).id})
        assert runner.run_next() is JobState.FAILED
        failure = store.jobs.get(plan.job_id).failure
        assert (failure.kind, failure.code) == (FailureKind.INTERNAL, "attempt-crashed")
        assert f"crashed ({crash}), which is a defect; please report it" in failure.detail


def test_a_job_whose_phantom_was_deleted_meanwhile_is_refused(store, start):
    phantom = store.phantoms.create(PhantomDrawing(name="disc", shapes=[Disc(center_mm=(0, 0), radius_mm=50)]))
    ask = PlanRequest(scanner_id=store.scanners.create(SCANNER).id, theta=THETA)
    plan = store.plans.accept(ask, given={"phantom_id": phantom.id})
    store.phantoms.delete(phantom.id)
    assert start().run_next() is JobState.FAILED
    failure = store.jobs.get(plan.job_id).failure
    assert (failure.kind, failure.code) == (FailureKind.INPUT, "phantom-deleted")


TOO_MUCH = (
    ("share-memory", "out-of-memory", "GiB of private and shared memory, and may take 0.5 GiB"),
    ("eat-memory", "out-of-memory", "more memory than the 0.5 GiB that it may take"),
    ("burn", "too-long", "of processor time that it may take: give a smaller file"),
    ("start-a-thread", "out-of-memory", "more memory than the 0.5 GiB that it may take"),
    ("write-much", "file-too-large", "a larger file than it may"),
    ("open-many", "too-many-files", "more than the 256 open files that it may have"),
)


@fresh_by_night
def test_a_job_that_takes_more_than_it_may_is_refused_once(store, start, settings, queue):
    runner = start()
    # Of fresh processes, which take a second each, one that is ended, one that answers and one that a signal ends.
    for behaviour, code, words in TOO_MUCH if settings.fork_attempts else TOO_MUCH[:3]:
        job = queue(behaviour)
        assert runner.run_next() is JobState.FAILED
        failure = store.jobs.get(job.id).failure
        assert (failure.kind, failure.code) == (FailureKind.INPUT, code)
        assert words in failure.detail


@fresh_by_night
def test_every_attempt_has_limits_by_default(store, start, queue):
    job = queue("tell-limits")
    assert start(memory_limit_bytes=None).run_next() is JobState.SUCCEEDED
    soft = {name: soft for name, (soft, _) in json.loads(store.scans.get(job.subject_id).remarks[0]).items()}
    hours = len(os.sched_getaffinity(0))
    assert soft["DATA"] == limits_of(kinds.INGEST, memory_bytes=0, file_bytes=0, memory_limit_bytes=None).data_bytes
    assert 0 < soft["CPU"] <= 3600 * hours + 60
    assert 0 < soft["FSIZE"] < 2**34
    assert (soft["NOFILE"], soft["CORE"]) == (256, 0)


@pytest.mark.parametrize(
    ("cores", "needed", "override", "limit"),
    [
        (2, 0, None, DATA_BYTES),
        (8, 3 * 2**30, None, 3 * 2**30),
        (64, 0, None, DATA_BYTES + 56 * 64 * 2**20),
        (64, 3 * 2**30, 2**29, 2**29),
    ],
)
def test_memory_is_what_the_sizes_need_and_room_for_threads(cores, needed, override, limit):
    needs = {"memory_bytes": needed, "file_bytes": 0}
    assert limits_of(kinds.CALIBRATE, **needs, memory_limit_bytes=override, on_cores=cores).data_bytes == limit


def test_a_file_may_be_as_large_as_the_job_needs_and_the_time_counts_every_core():
    needs = {"memory_bytes": 0, "memory_limit_bytes": None}
    one, many = (limits_of(kinds.RECONSTRUCT, **needs, file_bytes=0, on_cores=cores) for cores in (1, 12))
    assert (one.file_bytes, many.processor_s) == (FILE_BYTES, 12 * one.processor_s)
    assert limits_of(kinds.RECONSTRUCT, **needs, file_bytes=9 * 2**30).file_bytes == 9 * 2**30
