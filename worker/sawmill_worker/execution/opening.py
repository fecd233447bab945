"""Opening the store at a process's start, however long its database is away."""

import threading

import structlog

from sawmill_worker.storage.errors import StorageMisconfigured, StorageUnavailable
from sawmill_worker.storage.settings import StorageSettings
from sawmill_worker.storage.store import Store

_FIRST_WAIT_S = 0.5
_LONGEST_WAIT_S = 10.0


def open_store(settings: StorageSettings, stop: threading.Event) -> Store | None:
    """Open a store, waiting for a database that does not answer yet.

    Parameters
    ----------
    settings
        As for `Store.open`.
    stop
        Ends the waiting.

    Returns
    -------
    Store or None
        None when `stop` was set before the database answered.

    Raises
    ------
    StorageMisconfigured
        Waiting would not help: a wrong URL or password, no such database.
    StorageFull, OSError
        The data folder cannot be used.
    """
    wait_s = _FIRST_WAIT_S
    while not stop.is_set():
        try:
            return Store.open(settings)
        except StorageMisconfigured:
            raise
        except StorageUnavailable as error:
            structlog.get_logger().warning("database-awaited", next_try_in_s=wait_s, reason=str(error))
            stop.wait(wait_s)
            wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)
    return None
