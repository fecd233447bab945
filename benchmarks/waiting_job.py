"""The job that waits in a store, done in this process as an attempt of a worker does it."""

import shutil
import time
from typing import Any, NamedTuple

from sawmill_platform.contracts.jobs import JobKind
from sawmill_store.store import Store
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.jobs.running import run


class Done(NamedTuple):
    """A job's result, its seconds by the clock, and the processor seconds of all threads and of its own thread."""

    result: dict[str, Any]
    clock_s: float
    processor_s: float
    own_thread_s: float


def do_waiting_job(store: Store, kind: JobKind) -> Done:
    """Run the oldest waiting job, which is of this kind, and commit its result."""
    claim = store.jobs.claim("benchmark")
    assert claim is not None
    assert claim.job.kind is kind
    output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
    given = store.jobs.handed_over(claim.job_id)
    attempt = MillAttempt(claim.job, given, output, report=lambda _: None, announce=lambda _: None)
    started = time.perf_counter(), time.process_time(), time.thread_time()
    result = run(attempt)
    ended = time.perf_counter(), time.process_time(), time.thread_time()
    # A slow job keeps checkpoints, which are no results.
    shutil.rmtree(attempt.checkpoints, ignore_errors=True)
    store.jobs.succeed(claim, store.jobs.check_output(kind, result, output)[0], output)
    return Done(result, *(after - before for before, after in zip(started, ended, strict=True)))
