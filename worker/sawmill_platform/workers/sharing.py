"""Division of a machine's cores among concurrent attempts."""

import os
from collections.abc import Mapping

import structlog

from sawmill_platform.attempts.limits import cores
from sawmill_platform.workers.settings import ExecutionSettings

VARIABLE = "NUMBA_NUM_THREADS"


def threads_each(settings: ExecutionSettings, environment: Mapping[str, str] = os.environ) -> int:
    """Return the number of threads of each attempt: the configured number, or a worker's share of the cores."""
    if settings.numba_num_threads is not None:
        return settings.numba_num_threads
    asked = environment.get(VARIABLE, "")
    return int(asked) if asked.isdecimal() and int(asked) > 0 else max(1, cores() // settings.workers)


def say_if_crowded(settings: ExecutionSettings) -> None:
    """Warn if the concurrent attempts can have more threads together than there are cores."""
    threads = threads_each(settings)
    if settings.workers * threads > max(cores(), settings.workers):
        structlog.get_logger().warning(
            "more-threads-than-cores",
            workers=settings.workers,
            threads_each=threads,
            cores=cores(),
            remedy=f"set SAWMILL_NUMBA_NUM_THREADS to {max(1, cores() // settings.workers)} or less, or unset it",
        )
    elif settings.workers > cores():
        structlog.get_logger().warning(
            "more-workers-than-cores", workers=settings.workers, cores=cores(), remedy="start fewer workers"
        )
