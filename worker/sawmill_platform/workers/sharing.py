"""Division of a machine's cores among concurrent attempts."""

import os
from collections.abc import Mapping

import structlog

from sawmill_platform.attempts.limits import cores
from sawmill_platform.workers.settings import ExecutionSettings

VARIABLE = "NUMBA_NUM_THREADS"


def threads_each(
    settings: ExecutionSettings, environment: Mapping[str, str] = os.environ, *, on_cores: int | None = None
) -> int:
    """Return the number of threads of each attempt: the configured number, or a worker's share of the cores."""
    if settings.numba_num_threads is not None:
        return settings.numba_num_threads
    asked = environment.get(VARIABLE, "")
    return int(asked) if asked.isdecimal() and int(asked) > 0 else max(1, (on_cores or cores()) // settings.workers)


def say_if_crowded(settings: ExecutionSettings, *, on_cores: int | None = None) -> None:
    """Warn if the concurrent attempts can have more threads together than there are cores (see `threads_each`)."""
    on_cores = on_cores or cores()
    threads = threads_each(settings, on_cores=on_cores)
    if settings.workers * threads > max(on_cores, settings.workers):
        structlog.get_logger().warning(
            "more-threads-than-cores",
            workers=settings.workers,
            threads_each=threads,
            cores=on_cores,
            remedy=f"set SAWMILL_NUMBA_NUM_THREADS to {max(1, on_cores // settings.workers)} or less, or unset it",
        )
    elif settings.workers > on_cores:
        structlog.get_logger().warning(
            "more-workers-than-cores", workers=settings.workers, cores=on_cores, remedy="start fewer workers"
        )
