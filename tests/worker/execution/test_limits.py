"""Attempts that crash or take more than they may, in real processes over tasks without science."""

import json
import os
import signal

import pytest
from results import SCANNER_SPEC
from tiers import fresh_by_night

from sawmill_contracts import kinds
from sawmill_contracts.phantoms import PhantomDrawing, PhantomPicture
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.attempts.failures import died
from sawmill_platform.attempts.limits import DATA_BYTES, FILE_BYTES, limits_of
from sawmill_platform.contracts.jobs import FailureKind, JobKind, JobState
from sawmill_vocabulary import Disc, Theta

pytestmark = pytest.mark.slow

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
    limits = limits_of(kinds.CALIBRATE, **needs, memory_limit_bytes=override, on_cores=cores)
    assert limits.data_bytes == limit


def test_a_file_may_be_as_large_as_the_job_needs_and_the_time_counts_every_core():
    needs = {"memory_bytes": 0, "memory_limit_bytes": None}
    one, many = (limits_of(kinds.RECONSTRUCT, **needs, file_bytes=0, on_cores=cores) for cores in (1, 12))
    assert (one.file_bytes, many.processor_s) == (FILE_BYTES, 12 * one.processor_s)
    assert limits_of(kinds.RECONSTRUCT, **needs, file_bytes=9 * 2**30).file_bytes == 9 * 2**30
