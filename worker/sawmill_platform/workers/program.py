"""The program of a worker: its store, its share of the machine's cores, and the start of its attempts."""

import json
import os
import re
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import structlog
from pydantic_settings import BaseSettings

from sawmill_platform.attempts.limits import cores
from sawmill_platform.attempts.process import AttemptStarter, FreshProcesses
from sawmill_platform.attempts.template import Template, template_library
from sawmill_platform.attempts.threading_layer import configure_threads
from sawmill_platform.errors import FolderUnavailable, StorageMisconfigured, StorageUnavailable
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.housekeeping import Housekeeping
from sawmill_platform.workers.settings import ExecutionSettings

S = TypeVar("S", bound=JobServiceStore)


@dataclass(frozen=True)
class WorkerProgram(Generic[S]):
    """A worker's program."""

    # Function from the settings to a store that has been set up; raises `StorageUnavailable` until it has.
    open_store: Callable[[StorageSettings], S]
    # Function from a store, settings and an event that ends the housekeeping, to the housekeeping.
    housekeeping: Callable[[S, ExecutionSettings, threading.Event], Housekeeping]
    # Command of the process of an attempt, which speaks `sawmill_platform.attempts.protocol`.
    attempt_command: Sequence[str]

    def attempts(self, store: S, settings: ExecutionSettings) -> AttemptStarter:
        """Return the starter of the processes of attempts."""
        return attempt_starter(self.attempt_command, store, settings)


def attempt_starter(command: Sequence[str], store: JobServiceStore, settings: ExecutionSettings) -> AttemptStarter:
    """Return the starter of attempts, which forks them if the settings and the system allow that."""
    environment = attempt_environment(store, settings)
    library = template_library() if settings.fork_attempts else None
    return FreshProcesses(command, environment) if library is None else Template(command, environment, library)


def attempt_environment(store: JobServiceStore, settings: ExecutionSettings) -> dict[str, str]:
    """Return the environment variables of the processes of attempts."""
    environment = environment_of_attempts(settings)
    # Compiled kernels are kept with the installation; a read-only installation has no place for them and would raise.
    if not os.access(Path(__file__).parent, os.W_OK):
        environment.setdefault("NUMBA_CACHE_DIR", str(store.files.folder / "numba-cache"))
    configure_threads(environment)
    environment[VARIABLE] = str(threads_each(settings))
    return environment


SECRETS = frozenset({"SAWMILL_TOKEN", "SAWMILL_TOKEN_FILE"})
# Variables that Python, the numerical libraries and the logs read; any other variable may contain a password.
FOR_ATTEMPTS = re.compile(
    r"PATH|HOME|LANG|LANGUAGE|TZ|TERM|COLUMNS|NO_COLOR|FORCE_COLOR|TMPDIR|GLIBC_TUNABLES|VIRTUAL_ENV"
    r"|(LC|LD|MALLOC|NUMBA|TBB|OMP|GOMP|KMP|OPENBLAS|MKL|HDF5)_\w+|PYTHON\w+"
)


def environment_with(*settings: BaseSettings) -> dict[str, str]:
    """Return this process's environment with these settings as variables; the variables of null settings are unset.

    The service's token is not passed on: the children read strangers' files and need no token.
    """
    return _with_settings({name: value for name, value in os.environ.items() if name.upper() not in SECRETS}, settings)


def environment_of_attempts(settings: ExecutionSettings) -> dict[str, str]:
    """Return the variables that processes of attempts need, with the settings and without a secret."""
    needed = {name: value for name, value in os.environ.items() if FOR_ATTEMPTS.fullmatch(name)}
    return _with_settings(needed, [settings.model_copy(update={"broker_url": None})])


def _with_settings(environment: dict[str, str], settings: Iterable[BaseSettings]) -> dict[str, str]:
    for group in settings:
        prefix = group.model_config.get("env_prefix", "")
        for name, value in group.model_dump(mode="json").items():
            variable = f"{prefix}{name}".upper()
            if value is None:
                environment.pop(variable, None)
            else:
                environment[variable] = json.dumps(value) if isinstance(value, list) else str(value)
    return environment


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


_FIRST_WAIT_S = 0.5
_LONGEST_WAIT_S = 10.0


def open_store(open_once: Callable[[], S], stop: threading.Event) -> S | None:
    """Open a store; wait for a database that does not answer yet and for a data folder that is not there yet.

    Parameters
    ----------
    open_once
        Function that opens the store, or raises `StorageUnavailable`.
    stop
        Event that ends the waiting.

    Returns
    -------
    store or None
        None if `stop` was set before.

    Raises
    ------
    StorageMisconfigured
        Waiting would not help: a wrong URL or password, no such database.
    StorageFull, OSError
        The data folder cannot be used.
    """
    wait_s, logged = _FIRST_WAIT_S, ""
    while not stop.is_set():
        try:
            return open_once()
        except StorageMisconfigured:
            raise
        except StorageUnavailable as error:
            if str(error) != logged:
                awaited = "data-folder-awaited" if isinstance(error, FolderUnavailable) else "database-awaited"
                structlog.get_logger().warning(awaited, reason=str(error))
                logged = str(error)
            stop.wait(wait_s)
            wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)
    return None
