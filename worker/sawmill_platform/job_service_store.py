"""Rows and files of the job service, behind one object that other packages extend."""

import sqlite3
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import Connection, text
from sqlalchemy.exc import DatabaseError

from sawmill_platform.database.clock import Clock
from sawmill_platform.database.database import Database, newest_revision, revision_of, why_unreadable
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import Base
from sawmill_platform.errors import FolderUnavailable
from sawmill_platform.files.file_store import FileStore, refuse_half_restored, refuse_read_only
from sawmill_platform.files.folder_identity import check_identity, settle_identity
from sawmill_platform.files.named_folders import Leftovers, lost_files, named_by
from sawmill_platform.files.verified_results import VerifiedResults
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.jobs.queue_limits import Places
from sawmill_platform.jobs.tallies import Subjects, Tallies
from sawmill_platform.keys.key_store import KeyStore, Sessions
from sawmill_platform.keys.repeats import Repeats
from sawmill_platform.ledger.audit import Audit
from sawmill_platform.ledger.events import Events
from sawmill_platform.settings import StorageSettings
from sawmill_platform.uploads.upload_store import Uploads
from sawmill_platform.webhooks.outbox import Outbox
from sawmill_platform.webhooks.webhook_store import WebhookStore


class DatabaseReport(NamedTuple):
    """Report of a database."""

    system: str  # name and version of the database system
    # migration, newest_migration: migration to which the tables were brought, and the newest one that this version
    # knows.
    migration: str | None
    newest_migration: str
    answered_s: float  # time that these queries took
    size_bytes: int  # size of tables and indexes
    unreadable: str | None  # reason why this version cannot read the tables; None: it can, or brings them up to date


# Queries of version and size, by SQLAlchemy's name of the system.
_ASKED = {
    "sqlite": (
        "SQLite",
        "SELECT sqlite_version(), page_count * page_size FROM pragma_page_count(), pragma_page_size()",
    ),
    "postgresql": ("PostgreSQL", "SELECT current_setting('server_version'), pg_database_size(current_database())"),
}


class JobServiceStore:
    """The store of jobs and related rows; every method of a part is one transaction and uses contracts.

    Parameters
    ----------
    settings
        Places of rows and files.
    files
        The data folder.
    subjects
        Rows that jobs work on.
    clock
        Clock for rows and due times; null: the clock that all processes on this store share.
    """

    def __init__(
        self, settings: StorageSettings, files: FileStore, subjects: Subjects, clock: Clock | None = None
    ) -> None:
        refuse_half_restored(settings.data_folder)
        self.settings = settings  # with which another process can open the same store
        self.files = files
        self._named_folders = subjects.named_folders
        self.database = Database(make_engine(settings.url, settings.database_password_file), clock)
        self.places = Places(self.database, settings)  # of jobs in the queue, which are limited
        self.uploads = Uploads(self.database, files, settings.disk_reserve_bytes)
        self.jobs = Jobs(self.database, files, subjects)
        files.verified = VerifiedResults(
            self.jobs.digest_of_result, subjects.read_apart, self.jobs.note_digest_of_result
        )
        self.tallies = Tallies(self.database)
        self.events = Events(self.database)
        self.keys = KeyStore(self.database)
        self.sessions = Sessions(self.database)
        self.audit = Audit(self.database)
        self.repeats = Repeats(self.database)
        self.webhooks = WebhookStore(self.database)

    def outbox(self) -> Outbox:
        """Return the events that are to be sent to webhooks, for one sender."""
        return Outbox(self.database)

    def leftovers(self, *, grace_s: float, now_s: Callable[[], float] = time.monotonic) -> Leftovers:
        """Return the remover of files that no row names; its parameters belong to `Leftovers`."""
        return Leftovers(self.database, self.files, self._named_folders, grace_s=grace_s, now_s=now_s)

    def fill_new(self) -> None:
        """Write the rows that every store has."""

    def lost_files(self) -> list[str]:
        """Return the paths of files that rows name and that are missing; it raises what `lost_files` does."""
        return lost_files(self.database, self._named_folders, self.files.folder)

    def prepare(self, *, may_begin: bool = True) -> None:
        """Bring the tables up to date, in the folder of their database; close the store if that fails.

        Parameters
        ----------
        may_begin
            Whether to set up a new database and an empty folder. A worker does not: its share may not be mounted yet.

        Raises
        ------
        FolderUnavailable
            The data folder is missing, empty, another one or read-only: nothing was made in it.
        StorageMisconfigured, StorageFull, StorageUnavailable
            The database cannot be used.
        """
        settle = partial(settle_identity, folder=self.files.folder, may_begin=may_begin, named=self._needed_folders)
        try:
            self._prepare_folder(may_begin=may_begin)
            self.database.upgrade(and_then=settle)
            self.files.make_folders()
            self.database.start_clock()
            self.fill_new()
        except BaseException:
            self.close()
            raise

    def _needed_folders(self, connection: Connection) -> list[Path]:
        """Return the folders that rows of an earlier version name, and that identify its data folder."""
        named = named_by(connection, self._named_folders, Base.metadata.tables)
        return [self.files.folder / each.path for each in named if each.needed]

    def _prepare_folder(self, *, may_begin: bool) -> None:
        """Make the folder of a new database file, if a new one is allowed; refuse a folder on a read-only disk."""
        folder, file = self.files.folder, self.settings.database_file
        if not may_begin and ((file is not None and not file.is_file()) or self.database.is_new()):
            raise FolderUnavailable(
                f"the data folder {str(folder)!r} and its database have not been set up: mount the right folder, or "
                "start sawmill serve first"
            )
        if file is not None:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if folder.exists():
            refuse_read_only(folder)

    @property
    def time_has_an_owner(self) -> bool:
        """True if the time is a row that one process owns; false if it is a database server's time."""
        return self.database.engine.dialect.name == "sqlite"

    def now(self) -> datetime:
        """Return the time for the time stamps of rows."""
        return self.database.now()

    def clock_off_s(self) -> float:
        """Return the seconds by which this machine's clock is ahead of the store's."""
        return self.database.clock.off_s()

    def database_report(self) -> DatabaseReport:
        """Return the database's name, size and response time, or raise `StorageUnavailable`."""
        name, statement = _ASKED[self.database.engine.dialect.name]
        started = time.perf_counter()
        with self.database.read() as session:
            version, size_bytes = session.execute(text(statement)).one()
            migration = revision_of(session.connection())
            unreadable = why_unreadable(session.connection())
        answered_s = time.perf_counter() - started
        return DatabaseReport(f"{name} {version}", migration, newest_revision(), answered_s, size_bytes, unreadable)

    def damage(self) -> list[str]:
        """Return the defects that SQLite reports in its file, in its own words; none for a database server.

        SQLite reads the whole file: some seconds a gigabyte. Raises `StorageUnavailable`.
        """
        if self.database.engine.dialect.name != "sqlite":
            return []
        with self.database.read() as session:
            try:
                found = session.scalars(text("PRAGMA quick_check(5)")).all()
            except DatabaseError as error:
                # The file is so damaged that it cannot be checked.
                if getattr(error.orig, "sqlite_errorcode", None) != sqlite3.SQLITE_CORRUPT:
                    raise
                return [str(error.orig)]
        return [] if found == ["ok"] else list(found)

    def check(self, *, reserve_bytes: int | None = None) -> None:
        """Check that rows and files can be written.

        Parameters
        ----------
        reserve_bytes
            Free bytes below which the disk counts as full; null: the settings' reserve.

        Raises
        ------
        StorageUnavailable
            The database does not answer, or the data folder is not in its place or cannot be written to.
        StorageFull
            The disk is full, or nearly so.
        """
        self.check_folder()
        self.files.check_writable()
        if reserve_bytes is None:
            self.files.check_room(self.settings.disk_reserve_bytes, needed_by="SAWMILL_DISK_RESERVE_BYTES")
        else:
            self.files.check_room(reserve_bytes, needed_by="writing a result")

    def fill_spare_room(self) -> None:
        """Keep room for cancellations free as long as the disk does not count as full; raise `OSError`."""
        self.database.spare_room.fill(self.settings.disk_reserve_bytes)

    def check_folder(self) -> None:
        """Check that the data folder is the one of the database."""
        with self.database.read() as session:
            check_identity(session, self.files.folder)

    def close(self) -> None:
        """Close the connections to the database."""
        self.database.close()
