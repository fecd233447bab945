"""One service on a data folder whose database is a file: a lock that the kernel frees however its holder ends."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager

from sawmill_worker.storage.errors import StorageMisconfigured
from sawmill_worker.storage.settings import StorageSettings

LOCK = "serve.lock"


@contextmanager
def sole_service(settings: StorageSettings) -> Iterator[None]:
    """Be the only service on the data folder for the block; on PostgreSQL several are allowed.

    Raises
    ------
    StorageMisconfigured
        As `refuse_second`.
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
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            refuse_second(settings)
            raise
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
        yield


def refuse_second(settings: StorageSettings) -> None:
    """Refuse to serve a folder that is served, before anything is made.

    Raises
    ------
    StorageMisconfigured
        Another process serves it; the sentence has its id.
    """
    process = serving_process(settings)
    if process is not None:
        msg = (
            f"the data folder {str(settings.data_folder)!r} is served by process {process} already: stop that one, or "
            "give this one a folder of its own with --data or SAWMILL_DATA_FOLDER; several services on one folder need "
            "PostgreSQL (SAWMILL_DATABASE_URL)"
        )
        raise StorageMisconfigured(msg)


def serving_process(settings: StorageSettings) -> str | None:
    """The id of the process that serves a data folder; None: none does, or the database is a server.

    Raises
    ------
    OSError
        The lock cannot be read.
    """
    if not settings.is_one_file:
        return None
    try:
        with (settings.data_folder / LOCK).open() as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                # Empty for a moment, between the lock and the writing.
                return lock.read().strip() or "unknown"
    except FileNotFoundError:
        return None
    return None
