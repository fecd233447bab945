"""Opening of the store at a process's start, however long its database is away."""

import threading
from collections.abc import Callable
from typing import TypeVar

import structlog

from sawmill_platform.errors import FolderUnavailable, StorageMisconfigured, StorageUnavailable
from sawmill_platform.job_service_store import JobServiceStore

S = TypeVar("S", bound=JobServiceStore)

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
