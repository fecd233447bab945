"""Errors of a database that does not answer now, and limits on the threads that wait for the database."""

import math
import re
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.orm import Session

from sawmill_platform.errors import StorageError, StorageFull, StorageMisconfigured, StorageUnavailable

_PAUSE_S = 1.0
# Longer than the first thread of a queue waits for another process's lock: its failure answers the other threads too.
_TURN_S = 3.0
# Files that cannot be opened, are not writable, or contain something else.
_SQLITE_REFUSALS = {sqlite3.SQLITE_PERM, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_CANTOPEN}
_SQLITE_REFUSALS |= {sqlite3.SQLITE_AUTH, sqlite3.SQLITE_NOTADB}
_PG_DISK_FULL = "53100"
_PG_CROSSED = {"23505"}  # unique_violation: taken ids are refused before, and so by the next attempt
_PG_READ_ONLY = {"25006"}  # a server that has become a standby
# libpq gives no codes for errors before it is connected.
_PG_REFUSALS = re.compile(
    r"authentication failed|no password supplied|(database|role) \".*\" does not exist|no pg_hba\.conf entry"
    r"|permission denied for database|invalid (port|connection option|URI)|SSL was required|does not support SSL"
)


@contextmanager
def trouble_translated() -> Iterator[None]:
    """Raise a `StorageError` for an error of SQLAlchemy that means that a database cannot serve now."""
    try:
        yield
    except (DBAPIError, PoolTimeoutError) as error:
        meant = _translated(error)
        if meant is None:
            raise
        raise meant from error


class Door:
    """The beginning of transactions of one sort: the only part that waits for long when a database is away.

    While the database is away, one transaction at a time waits, a second later at the earliest. The other ones do not
    wait: they may have waited for their threads already.
    """

    def __init__(self) -> None:
        self._away: str | None = None
        self._wait_again_at = 0.0
        self._waiting = threading.Lock()

    def begin(self, session: Session) -> None:
        """Begin the session's transaction on the database."""
        away = self._away
        if away is None:
            self._ask(session)
        elif time.monotonic() >= self._wait_again_at and self._waiting.acquire(blocking=False):
            try:
                self._ask(session)
            finally:
                self._waiting.release()
        else:
            raise StorageUnavailable(away)

    def check(self) -> None:
        """Refuse work that would only be refused later, without a query to the database."""
        if self._away is not None and (time.monotonic() < self._wait_again_at or self._waiting.locked()):
            raise StorageUnavailable(self._away)

    def _ask(self, session: Session) -> None:
        try:
            session.connection()
        except (DBAPIError, PoolTimeoutError) as error:
            self._away = _sentence(error)
            self._wait_again_at = time.monotonic() + _PAUSE_S
            raise
        self._away = None


class WriterQueue:
    """The threads of a process that write to SQLite, one at a time in the order in which they came.

    SQLite has one write lock. A connection that finds the lock taken tries again now and then, in no order: of many,
    some never get it. So one thread of the process tries at a time, and only other processes can keep it waiting.
    """

    def __init__(self) -> None:
        self._turns: deque[threading.Event] = deque()
        self._changing = threading.Lock()
        self._moved_at = -math.inf

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Wait until every thread that came before has ended its block; the block is this thread's turn."""
        turn, came_at = threading.Event(), time.monotonic()
        with self._changing:
            self._turns.append(turn)
            self._turns[0].set()
        try:
            while not turn.wait(self._given_up_at(came_at) - time.monotonic()):
                if time.monotonic() >= self._given_up_at(came_at):
                    msg = f"the database does not answer: another request has kept it for {_TURN_S:g} s"
                    raise StorageUnavailable(msg)
            yield
        finally:
            with self._changing:
                if turn.is_set():
                    self._moved_at = time.monotonic()
                self._turns.remove(turn)
                if self._turns:
                    self._turns[0].set()

    def _given_up_at(self, came_at: float) -> float:
        return max(came_at, self._moved_at) + _TURN_S


def _translated(error: DBAPIError | PoolTimeoutError) -> StorageError | None:
    """Return the storage error that a database error means; None if the error is a defect."""
    original = getattr(error, "orig", None)
    number, state = getattr(original, "sqlite_errorcode", None), getattr(original, "sqlstate", None)
    if number == sqlite3.SQLITE_FULL or state == _PG_DISK_FULL:
        return StorageFull("the disk is full: the database cannot grow; free some space and try again")
    if state in _PG_CROSSED:
        return StorageUnavailable("another request changed the same rows at the same time; ask again")
    if number is not None and number & 0xFF in _SQLITE_REFUSALS:
        return StorageMisconfigured(_sentence(error))
    if state is None and _PG_REFUSALS.search(str(original)):
        return StorageMisconfigured(_sentence(error))
    away = isinstance(error, OperationalError | InterfaceError | PoolTimeoutError) or error.connection_invalidated
    return StorageUnavailable(_sentence(error)) if away or state in _PG_READ_ONLY else None


def _sentence(error: DBAPIError | PoolTimeoutError) -> str:
    reason = str(getattr(error, "orig", None) or error)
    return f"the database does not answer: {' '.join(reason.split())}"
