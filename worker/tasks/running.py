"""Which function does which kind of job."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from worker.contracts.jobs import JobKind
from worker.tasks.attempt import Attempt
from worker.tasks.calibrate import calibrate
from worker.tasks.drift import drift
from worker.tasks.failures import input_errors_translated
from worker.tasks.ingest import ingest
from worker.tasks.needs import Needs, needs_of
from worker.tasks.plan import plan
from worker.tasks.reconstruct import reconstruct
from worker.tasks.trace_phantom import trace_phantom
from worker.tomography.warm_up import warm_up

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
    worker.tasks.failures.JobFailure
        The input cannot be used; its sentence says why. Everything else that escapes is ours.
    """
    with input_errors_translated():
        return _TASKS[attempt.job.kind](attempt)
