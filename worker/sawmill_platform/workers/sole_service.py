"""The only service on a data folder whose database is a file: its lock, and the clock of the store, which it keeps.

The kernel frees the lock when its holder ends. The service owns the time and adopts lasting steps in its own clock. On
PostgreSQL the server's clock counts, and no process owns the time.
"""

import fcntl
import os
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self, TextIO

import structlog

from sawmill_platform.errors import StorageError, StorageMisconfigured
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.housekeeping import TOLERABLE_S
from sawmill_platform.workers.settings import process_name

LOCK = "serve.lock"


@contextmanager
def sole_service(settings: StorageSettings) -> Iterator[None]:
    """Be the only service on the data folder for the block; on PostgreSQL several are allowed.

    Raises
    ------
    StorageMisconfigured
        Another process serves the folder; the sentence has its id.
    OSError
        The data folder cannot be used.
    """
    if not settings.is_one_file:
        yield
        return
    settings.data_folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        with kernel_lock(settings.data_folder / LOCK):
            yield
    except HeldByAnother as other:
        raise _served(settings, str(other)) from other


def refuse_second(settings: StorageSettings) -> None:
    """Refuse to serve a folder that is served, before anything is made.

    Raises
    ------
    StorageMisconfigured, OSError
        Reasons as for `sole_service`.
    """
    process = serving_process(settings)
    if process is not None:
        raise _served(settings, process)


def serving_process(settings: StorageSettings) -> str | None:
    """Return the id of the process that serves a data folder; None: no process does, or the database is a server.

    The holder of the lock is read without taking the lock: a service that starts in this moment must not find it taken.

    Raises
    ------
    OSError
        The lock cannot be read.
    """
    if not settings.is_one_file:
        return None
    try:
        with (settings.data_folder / LOCK).open() as lock:
            kind, *_ = struct.unpack(_FLOCK, fcntl.fcntl(lock, fcntl.F_OFD_GETLK, _WHOLE_FILE))
            return None if kind == fcntl.F_UNLCK else _holder(lock)
    except FileNotFoundError:
        return None


def _served(settings: StorageSettings, process: str) -> StorageMisconfigured:
    return StorageMisconfigured(
        f"the data folder {str(settings.data_folder)!r} is served by process {process} already: stop that one, or "
        "give this one a folder of its own with --data or SAWMILL_DATA_FOLDER; several services on one folder need "
        "PostgreSQL (SAWMILL_DATABASE_URL)"
    )


# `struct flock` of fcntl(2) on 64-bit systems: type, whence, start, length, process.
_FLOCK = "hhqqi4x"
_WHOLE_FILE = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)


class HeldByAnother(Exception):  # noqa: N818 - no error of this process
    """Another process holds the lock; the message is its id, or `unknown`."""


@contextmanager
def kernel_lock(path: Path) -> Iterator[TextIO]:
    """Hold the lock on a file for the block; the file is made if it is missing, and stays.

    Raises
    ------
    HeldByAnother
        Another process holds the lock; the call does not wait.
    OSError
        The file cannot be written, or its file system has no locks.
    """
    # Not emptied before the lock is held: the file contains the holder's id.
    with path.open("a+") as lock:
        try:
            fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _WHOLE_FILE)
        except BlockingIOError as error:
            raise HeldByAnother(_holder(lock)) from error
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
        yield lock


def _holder(lock: TextIO) -> str:
    lock.seek(0)
    # Empty for a moment, between the lock and the writing.
    return lock.read().strip() or "unknown"


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
        self._monotonic = monotonic
        self._off_s, self._off_since_s = 0.0, monotonic()
        self._thread = threading.Thread(target=self._watch, name="clock", daemon=True)

    def __enter__(self) -> Self:
        if self._store.time_has_an_owner:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _watch(self) -> None:
        lasting_s = 0.0  # an offset of the service's clock at its start counts at once
        while not self._stop.is_set():
            try:
                self.look(lasting_s=lasting_s)
            except (StorageError, OSError) as error:
                structlog.get_logger().warning("clock-not-kept", reason=str(error))
            lasting_s = self._lasting_s
            self._stop.wait(self._look_s)

    def look(self, *, lasting_s: float) -> None:
        """Compare the clocks, and take a step over that has lasted that long, seconds."""
        off_s, now_s = self._store.clock_off_s(), self._monotonic()
        if abs(off_s - self._off_s) > TOLERABLE_S:
            self._off_s, self._off_since_s = off_s, now_s
        if now_s - self._off_since_s >= lasting_s and abs(off_s) > TOLERABLE_S:
            self._store.events.step_clock(process_name(), off_s)
            structlog.get_logger().warning("clock-stepped", off_s=round(off_s, 1))
