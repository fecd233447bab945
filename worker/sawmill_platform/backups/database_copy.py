"""Copies of a whole database at one instant: a file of SQLite, or one file of comma-separated rows a PostgreSQL table.

The server's own pg_dump is in no image or bundle of this product, so the rows are copied by COPY.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import JSON, Column, Connection, DateTime, MetaData, Table, delete, func, insert, inspect, select, text
from sqlalchemy.types import TypeEngine

from sawmill_platform.backups.backup import open_plain
from sawmill_platform.database.database import Database, has_tables, known_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import Base, ClockRow, UtcDateTime
from sawmill_platform.errors import BackupRefused, Damaged, StorageUnavailable
from sawmill_platform.files.file_store import refuse_half_restored
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.sole_service import sole_service

SQLITE_FILE = "sawmill.db"
_BLOCK_BYTES = 2**20


def write_database(connection: Connection, folder: Path) -> None:
    """Copy all that a transaction sees into a new folder."""
    folder.mkdir()
    driver: Any = connection.connection.dbapi_connection
    with _driver_trouble_translated(connection):
        if connection.dialect.name == "sqlite":
            with closing(sqlite3.connect(folder / SQLITE_FILE)) as copy:
                driver.backup(copy)
            return
        for table in tables_of(connection):
            names = ",".join(f'"{column.name}"' for column in table.columns)
            with (folder / f"{table.name}.csv").open("xb") as file:
                file.write(f"{names}\n".encode())
                with (
                    driver.cursor() as cursor,
                    cursor.copy(f"COPY {table.name} ({names}) TO STDOUT (FORMAT csv)") as rows,
                ):
                    file.writelines(rows)


def read_tables(connection: Connection, folder: Path) -> None:
    """Write the rows of a copy into empty PostgreSQL tables of the copy's revision."""
    driver: Any = connection.connection.dbapi_connection
    for table in tables_of(connection):
        path = folder / f"{table.name}.csv"
        with open_plain(path) as file, _driver_trouble_translated(connection):
            names = file.readline().decode(errors="replace").rstrip("\n")
            if sorted(names.split(",")) != sorted(f'"{column.name}"' for column in table.columns):
                raise Damaged(f"{path} has other columns than the table has at the revision that the backup names")
            with driver.cursor() as cursor, cursor.copy(f"COPY {table.name} ({names}) FROM STDIN (FORMAT csv)") as rows:
                while block := file.read(_BLOCK_BYTES):
                    rows.write(block)


def tables_of(connection: Connection) -> list[Table]:
    """Return our tables that exist, with the columns of their revision, referenced tables first."""
    inspector = inspect(connection)
    columns = inspector.get_multi_columns()
    names = [name for name, _ in inspector.get_sorted_table_and_fkc_names() if name in Base.metadata.tables]

    def table(name: str) -> Table:
        return Table(
            name, MetaData(), *(Column(each["name"], _as_stored(each["type"])) for each in columns[None, name])
        )

    return [table(name) for name in names if name is not None]


def continue_counting(connection: Connection) -> None:
    """Set PostgreSQL's counters behind the numbers of the copied rows; SQLite does so by itself."""
    if connection.dialect.name == "sqlite":
        return
    for table in Base.metadata.sorted_tables:
        if (column := table.autoincrement_column) is not None:
            last = f"SELECT setval(pg_get_serial_sequence('{table.name}', '{column.name}'), max({column.name}))"
            connection.execute(text(f"{last} FROM {table.name}"))


@contextmanager
def _driver_trouble_translated(connection: Connection) -> Iterator[None]:
    try:
        yield
    except connection.dialect.loaded_dbapi.Error as error:
        raise StorageUnavailable(f"the database ended its copy: {' '.join(str(error).split())}") from error


def _as_stored(kind: TypeEngine[Any]) -> TypeEngine[Any]:
    """Return the type by which rows are read and written: times in UTC, and no JSON is NULL, not the value `null`."""
    if isinstance(kind, DateTime):
        return UtcDateTime()
    return JSON(none_as_null=True) if isinstance(kind, JSON) else kind


_BATCH = 500


def copy_rows(source: StorageSettings, target: StorageSettings) -> int:
    """Copy all rows in one transaction and bring them up to date; the file of SQLite stays as it was.

    Returns
    -------
    int
        Number of rows that were copied.

    Raises
    ------
    BackupRefused
        There are no rows on SQLite, the target is no PostgreSQL, or it is not empty.
    StorageMisconfigured, StorageUnavailable
        The service runs, a database cannot be used, or the rows are of a later version.
    """
    if target.is_one_file:
        raise BackupRefused("set SAWMILL_DATABASE_URL to an empty PostgreSQL database")
    if not source.is_made:
        raise BackupRefused(f"there is no file of SQLite in {str(source.data_folder)!r}: give its folder with --data")
    refuse_half_restored(source.data_folder)
    with (
        sole_service(source),
        closing(Database(make_engine(source.url))) as old,
        closing(Database(make_engine(target.url, target.database_password_file))) as new,
        old.snapshot() as rows,
    ):
        with new.snapshot() as connection:
            if has_tables(connection):
                raise BackupRefused("the database of SAWMILL_DATABASE_URL is not empty: give an empty one")
        if (revision := known_revision(rows)) is None:
            raise BackupRefused("the file of SQLite has no tables: there is nothing to copy")
        tables = tables_of(rows)
        with new.filled(revision, lambda into: _copy(rows, into, tables)) as session:
            session.execute(delete(ClockRow))  # a server has its own time
            continue_counting(session.connection())
        return sum(rows.scalar(select(func.count()).select_from(table)) or 0 for table in tables)


def _copy(rows: Connection, into: Connection, tables: list[Table]) -> None:
    for table in tables:
        for batch in rows.execution_options(yield_per=_BATCH).execute(select(table)).mappings().partitions():
            into.execute(insert(table), [dict(row) for row in batch])
