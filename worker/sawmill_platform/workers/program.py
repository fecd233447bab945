"""The program of a worker, defined by the package that owns the kinds of jobs."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from sawmill_platform.attempts.process import AttemptStarter
from sawmill_platform.attempts.starting import attempt_starter
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.settings import StorageSettings
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
