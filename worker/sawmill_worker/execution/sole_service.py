"""One service on a data folder whose database is a file: a lock that the kernel frees however its holder ends."""

import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from sawmill_worker.storage.errors import StorageMisconfigured
from sawmill_worker.storage.settings import StorageSettings

LOCK = "serve.lock"
# `struct flock` of fcntl(2) on 64-bit systems: type, whence, start, length, process.
_FLOCK = "hhqqi4x"
_WHOLE_FILE = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)


@contextmanager
def sole_service(settings: StorageSettings) -> Iterator[None]:
    """Be the only service on the data folder for the block; on PostgreSQL several are allowed.

    Raises
    ------
    StorageMisconfigured
        Another process serves it; the sentence has its id.
    OSError
        The data folder cannot be used.
    """
    if not settings.is_one_file:
        yield
        return
    settings.data_folder.mkdir(parents=True, exist_ok=True)
    # Not emptied before it is held: it has the holder's id.
    with (settings.data_folder / LOCK).open("a+") as lock:
        try:
            fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _WHOLE_FILE)
        except BlockingIOError as error:
            raise _served(settings, _holder(lock)) from error
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
        yield


def refuse_second(settings: StorageSettings) -> None:
    """Refuse to serve a folder that is served, before anything is made.

    Raises
    ------
    StorageMisconfigured, OSError
        As `sole_service`.
    """
    process = serving_process(settings)
    if process is not None:
        raise _served(settings, process)


def serving_process(settings: StorageSettings) -> str | None:
    """The id of the process that serves a data folder; None: none does, or the database is a server.

    The lock is asked for its holder and not taken: a service that starts meanwhile must not find it taken.

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


def _holder(lock: TextIO) -> str:
    lock.seek(0)
    # Empty for a moment, between the lock and the writing.
    return lock.read().strip() or "unknown"


def _served(settings: StorageSettings, process: str) -> StorageMisconfigured:
    return StorageMisconfigured(
        f"the data folder {str(settings.data_folder)!r} is served by process {process} already: stop that one, or "
        "give this one a folder of its own with --data or SAWMILL_DATA_FOLDER; several services on one folder need "
        "PostgreSQL (SAWMILL_DATABASE_URL)"
    )
