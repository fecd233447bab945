"""Opening the store at a process's start, however long its database is away."""

import threading

import structlog

from sawmill_platform.errors import FolderUnavailable, StorageMisconfigured, StorageUnavailable
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

_FIRST_WAIT_S = 0.5
_LONGEST_WAIT_S = 10.0


def open_store(settings: StorageSettings, stop: threading.Event, *, may_begin: bool = True) -> Store | None:
    """Open a store, waiting for a database that does not answer yet and for a data folder that is not there yet.

    Parameters
    ----------
    settings
        As for `Store.open`.
    stop
        Ends the waiting.
    may_begin
        As for `Store.open`; a worker waits for the service to do so.

    Returns
    -------
    Store or None
        None when `stop` was set before.

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
            return Store.open(settings, may_begin=may_begin)
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
