"""Engine, transactions and migrations, on SQLite and PostgreSQL alike."""

import fcntl
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, Float, create_engine, event, text
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import Session
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement

from sawmill_worker.storage.errors import StorageFull, StorageUnavailable

Clock = Callable[[], datetime]

_BUSY_TIMEOUT_MS = 30_000
_MIGRATION_LOCK = 0x5A3111  # any number that only this product takes
_MIGRATIONS = Path(__file__).with_name("migrations")


def utc_now() -> datetime:
    """The time of this machine's clock."""
    return datetime.now(UTC)


class database_now_s(FunctionElement[float]):  # noqa: N801 - reads as a SQL function
    """Seconds since 1970 by the database's clock, to a millisecond."""

    type = Float(53)
    inherit_cache = True


@compiles(database_now_s, "sqlite")
def _now_on_sqlite(*_: object, **__: object) -> str:
    return "((julianday('now') - 2440587.5) * 86400.0)"


@compiles(database_now_s, "postgresql")
def _now_on_postgresql(element: database_now_s, compiler: SQLCompiler, **_: object) -> str:  # noqa: ARG001
    return "extract(epoch from clock_timestamp())::double precision"


def make_engine(url: str) -> Engine:
    """An engine whose write transactions are serialised where the database is SQLite."""
    engine = create_engine(url, pool_pre_ping=not url.startswith("sqlite"))
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _configure_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


def _configure_sqlite(connection: sqlite3.Connection, _: object) -> None:
    connection.isolation_level = None  # `begin` below decides how a transaction starts, not the driver
    for pragma in (
        f"busy_timeout={_BUSY_TIMEOUT_MS}",
        "journal_mode=WAL",
        "synchronous=FULL",
        "foreign_keys=ON",
    ):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    # A reader that turns writer in mid-transaction fails at once with "database is locked", whatever the timeout.
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


class Database:
    """Transactions on one engine.

    Parameters
    ----------
    engine
        From `make_engine`.
    clock
        The time for rows and schedules. Leases go by the database's clock instead.
    """

    def __init__(self, engine: Engine, clock: Clock = utc_now) -> None:
        self.engine = engine
        self.now = clock
        self._writer = engine.execution_options(writes=True)

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A transaction that only reads.

        Raises
        ------
        StorageUnavailable
            The database does not answer.
        """
        with _database_trouble_translated(), Session(self.engine) as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """A transaction that commits at the end of the block, or leaves no trace.

        Raises
        ------
        StorageFull, StorageUnavailable
            The database cannot write.
        """
        with _database_trouble_translated(), Session(self._writer, expire_on_commit=False) as session, session.begin():
            yield session

    def upgrade(self, revision: str = "head") -> None:
        """Bring the tables to a revision, the newest by default; safe when several processes start together.

        Raises
        ------
        StorageFull, StorageUnavailable
            The database cannot write.
        """
        with _database_trouble_translated(), _one_process_at_a_time(self.engine), self._writer.begin() as connection:
            lock_for_setup(connection)
            config = Config()
            config.set_main_option("script_location", str(_MIGRATIONS))
            config.attributes["connection"] = connection
            command.upgrade(config, revision)


@contextmanager
def _database_trouble_translated() -> Iterator[None]:
    try:
        yield
    except OperationalError as error:
        if getattr(error.orig, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            raise StorageFull("the disk is full: the database cannot grow; free some space and try again") from error
        raise StorageUnavailable(f"the database does not answer: {error.orig}") from error
    except (InterfaceError, PoolTimeoutError) as error:
        raise StorageUnavailable(f"the database does not answer: {error}") from error


def lock_for_setup(connection: Connection | Session) -> None:
    """Keep others from setting up the same database until the transaction ends; on SQLite any writer does."""
    bind: Any = connection.get_bind() if isinstance(connection, Session) else connection
    if bind.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": _MIGRATION_LOCK})


def _one_process_at_a_time(engine: Engine) -> AbstractContextManager[None]:
    # Turning a new SQLite file into a WAL one ignores the busy timeout, so the very first connection needs this lock.
    file = engine.url.database if engine.dialect.name == "sqlite" else None
    return _file_lock(Path(f"{file}.lock")) if file else nullcontext()


@contextmanager
def _file_lock(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
