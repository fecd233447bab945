"""The program of a worker, defined by the package that owns the kinds of jobs, and the start of its attempts."""

import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from sawmill_platform.attempts.environment import environment_of_attempts
from sawmill_platform.attempts.process import AttemptStarter, FreshProcesses
from sawmill_platform.attempts.template import Template, template_library
from sawmill_platform.attempts.threading_layer import configure_threads
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers import sharing
from sawmill_platform.workers.housekeeping import Housekeeping
from sawmill_platform.workers.settings import ExecutionSettings

S = TypeVar("S", bound=JobServiceStore)


@dataclass(frozen=True)
class WorkerProgram(Generic[S]):
    """A worker's program.

    Attributes
    ----------
    open_store : callable
        Function from the settings to a store that has been set up; raises `StorageUnavailable` until it has.
    housekeeping : callable
        Function from a store, settings and an event that ends the housekeeping, to the housekeeping.
    attempt_command : sequence of str
        Command of the process of an attempt, which speaks `sawmill_platform.attempts.protocol`.
    """

    open_store: Callable[[StorageSettings], S]
    housekeeping: Callable[[S, ExecutionSettings, threading.Event], Housekeeping]
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
    environment[sharing.VARIABLE] = str(sharing.threads_each(settings))
    return environment
