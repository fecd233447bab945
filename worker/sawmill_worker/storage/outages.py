"""Which of a database's errors mean that it does not answer now, and how threads are spared meanwhile."""

import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.orm import Session

from sawmill_worker.storage.errors import StorageFull, StorageUnavailable

_PAUSE_S = 1.0


@contextmanager
def trouble_translated() -> Iterator[None]:
    """Raise `StorageFull` or `StorageUnavailable` for what SQLAlchemy raises when a database cannot serve now."""
    try:
        yield
    except (DBAPIError, PoolTimeoutError) as error:
        if _means_full(error):
            raise StorageFull("the disk is full: the database cannot grow; free some space and try again") from error
        if not _means_away(error):
            raise
        raise StorageUnavailable(_sentence(error)) from error


class Door:
    """The beginning of transactions of one sort: the only part that waits for long when a database is away.

    For one that was found away, one transaction at a time waits, a second later at the earliest. The others do not:
    they may have waited for their threads already.
    """

    def __init__(self) -> None:
        self._away: str | None = None
        self._wait_again_at = 0.0
        self._waiting = threading.Lock()

    def begin(self, session: Session) -> None:
        """Begin the session's transaction on the database.

        Raises
        ------
        StorageUnavailable
            It was away a moment ago, and whether it still is will be known soon.
        DBAPIError, sqlalchemy.exc.TimeoutError
            It did not begin one.
        """
        away = self._away
        if away is None:
            self._ask(session)
        elif time.monotonic() >= self._wait_again_at and self._waiting.acquire(blocking=False):
            try:
                self._ask(session)
            finally:
                self._waiting.release()
        elif session.get_bind().dialect.name == "sqlite":
            session.connection(execution_options={"patient": False})
            self._away = None
        else:
            raise StorageUnavailable(away)

    def _ask(self, session: Session) -> None:
        try:
            session.connection()
        except (DBAPIError, PoolTimeoutError) as error:
            self._away = _sentence(error)
            self._wait_again_at = time.monotonic() + _PAUSE_S
            raise
        self._away = None


def _means_full(error: DBAPIError | PoolTimeoutError) -> bool:
    original = getattr(error, "orig", None)
    return getattr(original, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL


def _means_away(error: DBAPIError | PoolTimeoutError) -> bool:
    if isinstance(error, OperationalError | InterfaceError | PoolTimeoutError):
        return True
    return error.connection_invalidated


def _sentence(error: DBAPIError | PoolTimeoutError) -> str:
    return f"the database does not answer: {getattr(error, 'orig', None) or error}"
