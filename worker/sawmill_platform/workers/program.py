"""What a worker runs, as the package has it that owns the kinds of jobs."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from sawmill_platform.settings import StorageSettings
from sawmill_platform.store import JobServiceStore
from sawmill_platform.workers.housekeeping import Housekeeping
from sawmill_platform.workers.settings import ExecutionSettings

S = TypeVar("S", bound=JobServiceStore)


@dataclass(frozen=True)
class WorkerProgram(Generic[S]):
    """A worker's program.

    Attributes
    ----------
    open_store : callable
        From the settings to a store that has been set up; raises `StorageUnavailable` until it has.
    housekeeping : callable
        From a store, settings and an event that ends it to the housekeeping.
    attempt_command : sequence of str
        Starts the process of an attempt, which speaks `sawmill_platform.attempts.protocol`.
    """

    open_store: Callable[[StorageSettings], S]
    housekeeping: Callable[[S, ExecutionSettings, threading.Event], Housekeeping]
    attempt_command: Sequence[str]
