"""Lock for the only service on a data folder whose database is a file."""

from collections.abc import Iterator
from contextlib import contextmanager

from sawmill_platform.errors import StorageMisconfigured
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.kernel_lock import HeldByAnother, holder_of, kernel_lock

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
