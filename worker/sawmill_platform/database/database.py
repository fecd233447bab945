"""Transactions and migrations, on SQLite and PostgreSQL alike.

Reserve file next to SQLite's file, given up piece by piece for rows that must be written on a full disk. Only
cancellations use the reserve: without it, the job that fills the disk could not be stopped.
"""

import fcntl
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, inspect, text
from sqlalchemy.orm import Session

from sawmill_platform.database.clock import Clock, SharedClock, set_if_new
from sawmill_platform.database.engines import Door, WriterQueue, trouble_translated
from sawmill_platform.database.tables import Base
from sawmill_platform.errors import StorageMisconfigured, disk_outage_reported
from sawmill_vocabulary.version import VERSION

_MIGRATION_LOCK = 0x5A3111  # any number that only this product takes
_FILES_LOCK = 0x5A3112
_CHAIN = ('^revision = "(\\w+)"$', '^down_revision = "(\\w+)"$')
# Key in `info` of a session: functions that are called after its commit.
AFTER_COMMIT = "after commit"


@dataclass
class _Whole:
    """A transaction that contains the transactions which begin within it."""

    database: "Database"
    session: Session
    afterwards: list[Callable[[], None]] = field(default_factory=list)


_WHOLE: ContextVar[_Whole | None] = ContextVar("whole", default=None)


def after_commit(do: Callable[[], None]) -> None:
    """Call a function now, or after the commit if this thread is in the block of `write_as_one`."""
    whole = _WHOLE.get()
    if whole is None:
        do()
    else:
        whole.afterwards.append(do)


class Database:
    """Transactions on one engine.

    Parameters
    ----------
    engine
        Engine from `database.engines`.
    clock
        Clock for rows and due times; null: the clock that all processes on this database share.
    """

    def __init__(self, engine: Engine, clock: Clock | None = None) -> None:
        self.engine = engine
        self.clock = SharedClock(self.read)
        self.now = clock or self.clock
        one_writer = engine.dialect.name == "sqlite"
        self.spare_room = SpareRoom(Path(file) if one_writer and (file := engine.url.database) else None)
        self._writer = engine.execution_options(writes=True)
        # On SQLite every transaction is a snapshot.
        self._reader = engine if one_writer else engine.execution_options(isolation_level="REPEATABLE READ")
        self._reading = Door()
        # SQLite reads while another transaction holds its write lock.
        self._writing = Door() if one_writer else self._reading
        self._turn = WriterQueue().turn if one_writer else nullcontext

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Begin a transaction that only reads, in which all rows are as they were at one instant.

        Raises
        ------
        StorageUnavailable
            The database does not answer.
        """
        if whole := self._whole():
            yield whole.session
            return
        with trouble_translated(), Session(self._reader) as session:
            self._reading.begin(session)
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Begin a transaction that commits at the end of the block, or leaves no trace.

        Raises
        ------
        StorageFull, StorageUnavailable
            The database cannot write.
        """
        if whole := self._whole():
            with trouble_translated(), whole.session.begin_nested():
                yield whole.session
            return
        self._writing.check()
        with trouble_translated(), Session(self._writer, expire_on_commit=False) as session:
            with self._turn(), session.begin():
                self._writing.begin(session)
                yield session
            for log in session.info.get(AFTER_COMMIT, ()):
                log()

    def check_writable(self) -> None:
        """Refuse at once, before work that ends with a transaction, if the database is known to be away.

        Raises
        ------
        StorageUnavailable
            The database is away.
        """
        self._writing.check()

    @contextmanager
    def write_as_one(self) -> Iterator[Session]:
        """Begin a transaction as `write` does, with all that this thread reads and writes within the block as parts.

        Functions that are passed to `after_commit` in the block are called after the commit, and not at all without
        one.
        """
        with self.write() as session:
            whole = _Whole(self, session)
            token = _WHOLE.set(whole)
            try:
                yield session
            finally:
                _WHOLE.reset(token)
        for do in whole.afterwards:
            do()

    def _whole(self) -> _Whole | None:
        whole = _WHOLE.get()
        return whole if whole is not None and whole.database is self else None

    def upgrade(
        self, revision: str = "head", *, and_then: Callable[[Connection, bool], None] = lambda *_: None
    ) -> None:
        """Bring the tables to a revision, the newest by default; safe when several processes start together."""
        with self._setting_up() as connection:
            found = known_revision(connection)
            if revision != "head" or found != newest_revision():
                _migrate(connection, revision)
            and_then(connection, found is None)

    def is_new(self) -> bool:
        """Return whether there are no tables yet, or raise `StorageUnavailable`."""
        with self.read() as session:
            return revision_of(session.connection()) is None

    @contextmanager
    def snapshot(self) -> Iterator[Connection]:
        """Begin a transaction that reads as `read` does, however long each statement takes."""
        with trouble_translated(), self._reader.connect() as connection, _any_time(connection):
            yield connection

    @contextmanager
    def filled(self, revision: str, fill: Callable[[Connection], None]) -> Iterator[Session]:
        """Begin a transaction that makes tables of a revision, fills them and brings them up to date."""
        with self._setting_up() as connection, _any_time(connection):
            _migrate(connection, revision)
            fill(connection)
            if revision != newest_revision():
                _migrate(connection, "head")
            with Session(connection) as session:
                yield session
                session.flush()

    @contextmanager
    def _setting_up(self) -> Iterator[Connection]:
        """Begin a transaction that makes or changes tables: one at a time."""
        with trouble_translated(), _one_process_at_a_time(self.engine), self._writer.begin() as connection:
            lock_for_setup(connection)
            yield connection

    def start_clock(self) -> None:
        """Write the machine's time if this is the first process since its start; the tables must be up to date."""
        with self.write() as session:
            set_if_new(session)

    def close(self) -> None:
        """Close the connections."""
        self.engine.dispose()


class StorePart:
    """Part of a store: every method is one transaction on the database."""

    def __init__(self, database: Database) -> None:
        self._database = database


def newest_revision() -> str:
    """Return the number of the last migration of the chain; the chain's order is not the order of the numbers."""
    numbers, before = _chain()
    [newest] = numbers - before
    return newest


def is_known(revision: str) -> bool:
    """Return whether there is a migration of this number; other versions and development states have other numbers."""
    return revision in _chain()[0]


def _chain() -> tuple[set[str], set[str]]:
    """Return the numbers of all migrations, and of the migrations that another one follows."""
    texts = "".join(path.read_text() for path in (_migrations() / "versions").glob("*.py"))
    numbers, before = (set[str](re.findall(pattern, texts, re.MULTILINE)) for pattern in _CHAIN)
    return numbers, before


def revision_of(connection: Connection) -> str | None:
    """Return the number of the migration to which the tables were brought; None: there are no tables yet."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    found: str | None = connection.scalar(text("SELECT version_num FROM alembic_version"))
    return found


def known_revision(connection: Connection) -> str | None:
    """Return the number as `revision_of` does; raise `StorageMisconfigured` for tables that are not known."""
    reason = why_unreadable(connection)
    if reason is not None:
        raise StorageMisconfigured(reason)
    return revision_of(connection)


def why_unreadable(connection: Connection) -> str | None:
    """Describe tables that this version does not know, with both versions; None: they are known, or there are none."""
    found = revision_of(connection)
    if found is None or is_known(found):
        return None
    version: str | None = None  # of a database of 0.1.0, which has no such column
    if _notes_product_version(connection):
        version = connection.scalar(text("SELECT product_version FROM alembic_version"))
    tables = f"revision {found}" if version is None else f"version {version} (revision {found})"
    return (
        f"the database has tables of {tables}, which this program, version {VERSION} (revision {newest_revision()}), "
        f"cannot read: start {'the version that wrote them' if version is None else f'version {version}'}, or give an "
        "empty data folder or database"
    )


def _notes_product_version(connection: Connection) -> bool:
    return "product_version" in {column["name"] for column in inspect(connection).get_columns("alembic_version")}


def has_tables(connection: Connection) -> bool:
    """Return whether any table of ours exists."""
    return not {"alembic_version", *Base.metadata.tables}.isdisjoint(inspect(connection).get_table_names())


def _migrate(connection: Connection, revision: str) -> None:
    # Imported here: tables are hardly ever out of date, and Alembic costs every process 10 MiB and 0.2 s.
    from alembic import command  # noqa: PLC0415
    from alembic.config import Config  # noqa: PLC0415

    config = Config()
    config.set_main_option("script_location", str(_migrations()))
    config.attributes["connection"] = connection
    with _any_time(connection):
        command.upgrade(config, revision)
    if _notes_product_version(connection):
        connection.execute(text("UPDATE alembic_version SET product_version = :version"), {"version": VERSION})


def _any_time(connection: Connection) -> AbstractContextManager[None]:
    driver: Any = connection.connection.dbapi_connection
    return driver.unlimited() if connection.dialect.name == "postgresql" else nullcontext()


def lock_for_setup(connection: Connection | Session) -> None:
    """Prevent other processes from setting up the database until the transaction ends; on SQLite any writer does."""
    bind: Any = connection.get_bind() if isinstance(connection, Session) else connection
    if bind.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": _MIGRATION_LOCK})


def lock_files_of(session: Session, subject_id: str, *, wait: bool = True) -> bool:
    """Lock a subject's files until the write transaction ends; return whether it is locked. SQLite needs no lock."""
    if session.get_bind().dialect.name != "postgresql":
        return True
    key = {"files": _FILES_LOCK, "subject": subject_id}
    if wait:
        session.execute(text("SELECT pg_advisory_xact_lock(:files, hashtext(:subject))"), key)
        return True
    return bool(session.scalar(text("SELECT pg_try_advisory_xact_lock(:files, hashtext(:subject))"), key))


@contextmanager
def _one_process_at_a_time(engine: Engine) -> Iterator[None]:
    # Turning a new SQLite file into a WAL one ignores the busy timeout, so the very first connection needs this lock.
    if engine.dialect.name != "sqlite" or not engine.url.database:
        yield
        return
    path = Path(f"{engine.url.database}.lock")
    with disk_outage_reported("opening the database"):
        opened = path.open("w")
    with opened as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _migrations() -> Path:
    """Return the folder of the migrations, which is named by the package that completes the tables."""
    return Path(Base.metadata.info["migrations"])


# A cancellation changes some thirty pages of 4 KiB, which the write-ahead log takes.
PIECE_BYTES = 256 * 2**10
SPARE_BYTES = 16 * PIECE_BYTES


class SpareRoom:
    """A file without content that uses disk space; processes share it."""

    def __init__(self, database: Path | None) -> None:
        self._path = None if database is None else Path(f"{database}.spare")

    def fill(self, reserve_bytes: int) -> None:
        """Restore the file if the disk then still has this number of bytes free; raise `OSError`."""
        path = self._path
        if path is None or (path.exists() and path.stat().st_size == SPARE_BYTES):
            return
        if shutil.disk_usage(path.parent).free >= reserve_bytes + SPARE_BYTES:
            with path.open("ab") as file:
                os.posix_fallocate(file.fileno(), 0, SPARE_BYTES)

    def give_up_piece(self) -> None:
        """Release a piece for the current transaction; if that fails, the transaction reports the full disk."""
        if self._path is not None:
            with suppress(OSError):
                os.truncate(self._path, max(self._path.stat().st_size - PIECE_BYTES, 0))
