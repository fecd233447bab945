"""Clock of a store whose database is a file: the one process that owns the time adopts lasting steps in its own clock.

The owner is the service, of which there is one on such a store (`sole_service`). On PostgreSQL the server's clock
counts, and no process owns the time.
"""

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import structlog

from sawmill_platform.errors import StorageError
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.workers.housekeeping import TOLERABLE_S
from sawmill_platform.workers.settings import process_name

# A step of the machine's clock counts after this time: one that is corrected at once moves no due time.
LASTING_S = 60.0
_LOOK_S = 1.0


class ClockKeeper:
    """Watcher of this machine's clock in a thread, as a context manager.

    Parameters
    ----------
    store
        Store whose time is kept.
    lasting_s
        Seconds that a step must last.
    look_s
        Seconds between two readings of the clock.
    monotonic
        Clock by which a step lasts, seconds.
    """

    def __init__(
        self,
        store: JobServiceStore,
        *,
        lasting_s: float = LASTING_S,
        look_s: float = _LOOK_S,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._store = store
        self._lasting_s = lasting_s
        self._look_s = look_s
        self._stop = threading.Event()
        self._step = _Step(monotonic)
        self._thread = threading.Thread(target=self._watch, name="clock", daemon=True)

    def __enter__(self) -> Self:
        if self._store.time_has_an_owner:
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _watch(self) -> None:
        first = True
        while not self._stop.is_set():
            try:
                # An offset of the service's clock at its start counts at once.
                self.look(lasting_s=0.0 if first else self._lasting_s)
            except (StorageError, OSError) as error:
                structlog.get_logger().warning("clock-not-kept", reason=str(error))
            first = False
            self._stop.wait(self._look_s)

    def look(self, *, lasting_s: float) -> None:
        """Compare the clocks, and take a step over that has lasted that long, seconds."""
        off_s = self._store.clock_off_s()
        if self._step.lasts_s(off_s) >= lasting_s and abs(off_s) > TOLERABLE_S:
            self._store.events.step_clock(process_name(), off_s)
            structlog.get_logger().warning("clock-stepped", off_s=round(off_s, 1))


class _Step:
    """Time for which a clock has been off by the same amount."""

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._off_s, self._since = 0.0, monotonic()

    def lasts_s(self, off_s: float) -> float:
        now = self._monotonic()
        if abs(off_s - self._off_s) > TOLERABLE_S:
            self._off_s, self._since = off_s, now
        return now - self._since
