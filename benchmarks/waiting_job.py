"""The job that waits in a store, done in this process as an attempt of a worker does it."""

import time
from typing import Any, NamedTuple

from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.running import run
from sawmill_worker.storage.store import Store


class Done(NamedTuple):
    """A job's result, and the seconds that it took by the clock and of all threads."""

    result: dict[str, Any]
    clock_s: float
    processor_s: float


def do_waiting_job(store: Store, kind: JobKind) -> Done:
    """Do the oldest one, which is of this kind, and commit its result."""
    claim = store.jobs.claim("benchmark")
    assert claim is not None
    assert claim.job.kind is kind
    output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
    given = store.jobs.handed_over(claim.job_id)
    attempt = Attempt(claim.job, given, output, report=lambda _: None, announce=lambda _: None)
    clock, processor = time.perf_counter(), time.process_time()
    result = run(attempt)
    clock, processor = time.perf_counter() - clock, time.process_time() - processor
    store.jobs.succeed(claim, result, output)
    return Done(result, clock, processor)
