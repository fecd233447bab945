"""Lock for the only service on a data folder whose database is a file, freed by the kernel when its holder ends."""

import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from sawmill_platform.errors import StorageMisconfigured
from sawmill_platform.settings import StorageSettings

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
    return holder_of(settings.data_folder / LOCK) if settings.is_one_file else None


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


def holder_of(path: Path) -> str | None:
    """Return the id of the process that holds a lock, without taking the lock; None: no process holds it."""
    try:
        with path.open() as lock:
            kind, *_ = struct.unpack(_FLOCK, fcntl.fcntl(lock, fcntl.F_OFD_GETLK, _WHOLE_FILE))
            return None if kind == fcntl.F_UNLCK else _holder(lock)
    except FileNotFoundError:
        return None


def _holder(lock: TextIO) -> str:
    lock.seek(0)
    # Empty for a moment, between the lock and the writing.
    return lock.read().strip() or "unknown"
