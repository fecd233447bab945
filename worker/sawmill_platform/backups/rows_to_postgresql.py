"""Copy of the rows of a stopped service from SQLite into an empty PostgreSQL; its data folder stays where it is."""

from contextlib import closing

from sqlalchemy import Connection, Table, delete, func, insert, select

from sawmill_platform.backups.database_copy import continue_counting, tables_of
from sawmill_platform.database.database import Database, has_tables, known_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import ClockRow
from sawmill_platform.errors import BackupRefused
from sawmill_platform.files.file_store import refuse_half_restored
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.sole_service import sole_service

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
