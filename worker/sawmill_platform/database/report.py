"""Report for operators: the database's system, version, size and response time."""

import sqlite3
import time
from typing import NamedTuple

from sqlalchemy import text
from sqlalchemy.exc import DatabaseError

from sawmill_platform.database.database import Database, newest_revision, revision_of, why_unreadable


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
    "postgresql": (
        "PostgreSQL",
        "SELECT current_setting('server_version'), pg_database_size(current_database())",
    ),
}


def report_of(database: Database) -> DatabaseReport:
    """Query a database.

    Raises
    ------
    StorageUnavailable
        The database does not answer.
    """
    name, statement = _ASKED[database.engine.dialect.name]
    started = time.perf_counter()
    with database.read() as session:
        version, size_bytes = session.execute(text(statement)).one()
        migration = revision_of(session.connection())
        unreadable = why_unreadable(session.connection())
    answered_s = time.perf_counter() - started
    return DatabaseReport(f"{name} {version}", migration, newest_revision(), answered_s, size_bytes, unreadable)


def damage_of(database: Database) -> list[str]:
    """Return the defects that SQLite reports in its file, in its own words; none for a database server.

    SQLite reads the whole file: some seconds a gigabyte.
    """
    if database.engine.dialect.name != "sqlite":
        return []
    with database.read() as session:
        try:
            found = session.scalars(text("PRAGMA quick_check(5)")).all()
        except DatabaseError as error:
            # The file is so damaged that it cannot be checked.
            if getattr(error.orig, "sqlite_errorcode", None) != sqlite3.SQLITE_CORRUPT:
                raise
            return [str(error.orig)]
    return [] if found == ["ok"] else list(found)
