"""Engines on SQLite and PostgreSQL: connections, time limits for an answer, and errors of a silent database."""

import math
import re
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.orm import Session

from sawmill_platform.errors import StorageError, StorageFull, StorageMisconfigured, StorageUnavailable

# A request that has to write answers within five seconds, and may wait only this long for the lock: the rest is reserve
# for a machine whose cores are all busy.
_BUSY_TIMEOUT_MS = 2_500
_KEPT_CONNECTIONS = 10
# One for each of the API's threads, of which FastAPI has 40, and one for a thread that reads the time.
_MOST_CONNECTIONS = 41
_POOL_WAIT_S = 3.0
_POSTGRESQL = {"postgresql", "postgres", "postgresql+psycopg"}
_FORMS = "sqlite:////path/to/file or postgresql://user:password@host/database"


def make_engine(url: str, password_file: Path | None = None) -> Engine:
    """Return an engine whose transactions give up in a few seconds, and whose writes are serialised on SQLite."""
    parsed = _parsed(url)
    if password_file is not None:
        if parsed.drivername not in _POSTGRESQL or parsed.password is not None:
            raise StorageMisconfigured(
                "SAWMILL_DATABASE_PASSWORD_FILE goes with a SAWMILL_DATABASE_URL without a password, as in "
                "postgresql://user@host/database"
            )
        try:
            password = password_file.read_text().rstrip("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise StorageMisconfigured(f"SAWMILL_DATABASE_PASSWORD_FILE cannot be read: {error}") from error
        if not password:
            raise StorageMisconfigured(f"SAWMILL_DATABASE_PASSWORD_FILE holds no password: {password_file} is empty")
        parsed = parsed.set(password=password)
    # A statement's values, which include other people's data, are kept out of error messages, and so out of logs.
    options = {"pool_size": _KEPT_CONNECTIONS, "pool_timeout": _POOL_WAIT_S, "hide_parameters": True}
    if parsed.drivername in _POSTGRESQL:
        try:
            from sawmill_platform.database.postgresql import make_patient  # noqa: PLC0415 - the driver is an extra
        except ImportError as error:
            raise StorageMisconfigured(
                f"PostgreSQL needs its driver ({error}): pip install 'sawmill-calibration[postgresql]'"
            ) from error
        driven = parsed.set(drivername="postgresql+psycopg")
        engine = create_engine(driven, max_overflow=_MOST_CONNECTIONS - _KEPT_CONNECTIONS, **options)
        make_patient(engine)
        return engine
    # Without a limit on connections, the pool has at most one for each of the process's threads.
    engine = create_engine(parsed, max_overflow=-1, **options)
    event.listen(engine, "connect", _configure_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _parsed(url: str) -> URL:
    try:
        parsed = make_url(url)
    except ArgumentError as error:  # a URL may hold a password, so it is not repeated
        raise StorageMisconfigured(f"SAWMILL_DATABASE_URL is no URL of a database; give {_FORMS}") from error
    if parsed.drivername not in {"sqlite", *_POSTGRESQL}:
        raise StorageMisconfigured(
            f"SAWMILL_DATABASE_URL must begin with sqlite: or postgresql:, not {parsed.drivername!r}; give {_FORMS}"
        )
    return parsed


def _configure_sqlite(connection: sqlite3.Connection, _: object) -> None:
    connection.isolation_level = None  # `begin` below decides how a transaction starts, not the driver
    for pragma in (f"busy_timeout={_BUSY_TIMEOUT_MS}", "journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    options = connection.get_execution_options()
    # A reader that turns writer in mid-transaction fails at once with "database is locked", whatever the timeout.
    connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get("writes", False) else "BEGIN")


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
                    raise StorageUnavailable(
                        f"the database does not answer: another request has kept it for {_TURN_S:g} s"
                    )
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
    refuses = number is not None and number & 0xFF in _SQLITE_REFUSALS
    if refuses or (state is None and _PG_REFUSALS.search(str(original))):
        return StorageMisconfigured(_sentence(error))
    away = isinstance(error, OperationalError | InterfaceError | PoolTimeoutError) or error.connection_invalidated
    return StorageUnavailable(_sentence(error)) if away or state in _PG_READ_ONLY else None


def _sentence(error: DBAPIError | PoolTimeoutError) -> str:
    reason = str(getattr(error, "orig", None) or error)
    return f"the database does not answer: {' '.join(reason.split())}"
