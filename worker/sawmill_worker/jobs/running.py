"""Which function does which kind of job."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.calibrate import calibrate
from sawmill_worker.jobs.drift import drift
from sawmill_worker.jobs.ingest import ingest
from sawmill_worker.jobs.needs import Needs, needs_of
from sawmill_worker.jobs.plan import plan
from sawmill_worker.jobs.reconstruct import reconstruct
from sawmill_worker.jobs.trace_phantom import trace_phantom
from sawmill_worker.tomography.warm_up import warm_up
from sawmill_worker.use_cases.failures import input_errors_translated

__all__ = ["Attempt", "Needs", "needs_of", "run", "warm_up"]

_TASKS: Mapping[JobKind, Callable[[Attempt], dict[str, Any]]] = MappingProxyType(
    {
        JobKind.INGEST: ingest,
        JobKind.TRACE_PHANTOM: trace_phantom,
        JobKind.CALIBRATE: calibrate,
        JobKind.RECONSTRUCT: reconstruct,
        JobKind.PLAN: plan,
        JobKind.DRIFT: drift,
    }
)


def run(attempt: Attempt) -> dict[str, Any]:
    """Do the job: files into the attempt's output folder, the JSON answer returned.

    Raises
    ------
    sawmill_worker.use_cases.failures.JobFailure
        The input cannot be used; its sentence says why. Everything else that escapes is ours.
    """
    with input_errors_translated():
        return _TASKS[attempt.job.kind](attempt)
