"""Restoring a backup into an empty data folder and an empty database of the same kind.

No store opens while the data folder has the mark of a restore. The files are copied first; then the rows are committed,
which name the identity that the folder has; then the mark is removed. After a kill the command is given again: if the
rows were committed, only the mark has to be removed; otherwise the restore starts again.
"""

import shutil
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

from sqlalchemy import Connection, delete, inspect, select

from sawmill_platform.backups.backup import DATA, DATABASE, Backup, Manifest, alone_with, counted
from sawmill_platform.backups.database_copy import SQLITE_FILE, continue_counting, read_tables
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.database import Database, has_tables, is_known, newest_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import ClockRow, DataFolderRow, JobRow, JobTurnRow, SessionRow
from sawmill_platform.errors import BackupRefused, Damaged
from sawmill_platform.files.file_store import RESTORING, FileStore, read_identity
from sawmill_platform.files.folder_identity import write_identity
from sawmill_platform.files.whole_files import flush, flushed_file_system
from sawmill_platform.jobs.job_store import requeue
from sawmill_platform.ledger.events import record, record_restored
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.sole_service import refuse_second, sole_service
from sawmill_vocabulary import ProgressCallback
from sawmill_vocabulary.version import VERSION

# Names that an empty data folder may have: the folder of a separate disk, and the lock of the service.
_NOTHING = {"lost+found", "serve.lock"}
# Logins are not restored, a clock belongs to a machine, a restored folder gets a new identity, and turns start again.
NOT_RESTORED = (SessionRow, ClockRow, DataFolderRow, JobTurnRow)


def restore(backup_folder: Path, settings: StorageSettings, on_progress: ProgressCallback) -> Manifest | None:
    """Restore a backup and compare every sum.

    Returns
    -------
    Manifest or None
        Manifest of the backup. None: an earlier restore had written everything before it was killed.

    Raises
    ------
    BackupRefused
        The folder or the database is not empty, another restore is running, or the backup is of a later version or of
        the other kind of database.
    Damaged
        The backup is not as it was written: nothing is restored.
    StorageFull, StorageUnavailable, OSError
        The data folder is served, or it or the database cannot be written to: nothing is restored.
    """
    refuse_second(settings)
    backup = _checked(backup_folder, settings)
    _check_empty(settings)
    folder = settings.data_folder.absolute()
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with sole_service(settings), alone_with(folder / RESTORING, "restore into"):
        flush(folder)
        is_complete = _check_empty(settings)  # once more: another restore may just have ended
        if not is_complete:
            _clear(folder, settings)
            _restore(backup, folder, settings, on_progress)
        (folder / RESTORING).unlink(missing_ok=True)
    FileStore(folder).make_folders()
    flush(folder)
    return None if is_complete else backup.manifest


def _check_empty(settings: StorageSettings) -> bool:
    """Refuse a folder or database that is not empty; return whether a killed restore had committed all rows."""
    folder, file = settings.data_folder, settings.database_file
    was_started = (folder / RESTORING).exists()
    names = sorted({path.name for path in folder.iterdir()} - _NOTHING) if folder.is_dir() and not was_started else []
    if names:
        raise BackupRefused(
            f"{str(folder)!r} is not empty ({', '.join(names[:3])}): a backup is restored into an empty folder alone"
        )
    identity = _identity_in_database(settings)
    if identity is not None and not (was_started and identity == read_identity(folder)):
        where = "the database of SAWMILL_DATABASE_URL" if file is None else repr(str(file))
        raise BackupRefused(f"{where} is not empty: a backup is restored into an empty database alone")
    return identity is not None


def _restore(backup: Backup, folder: Path, settings: StorageSettings, on_progress: ProgressCallback) -> None:
    file, decided = settings.database_file, False

    def fill(connection: Connection) -> None:
        if file is None:
            read_tables(connection, backup.folder / DATABASE)

    to_url = settings.url if file is None else f"sqlite:///{_unfinished(file)}"
    try:
        with flushed_file_system(folder):
            for path in counted([path for path in backup.sums if path.startswith(f"{DATA}/")], on_progress):
                target = folder / path.removeprefix(f"{DATA}/")
                target.parent.mkdir(parents=True, exist_ok=True)
                backup.compare(path, target)
        if file is not None:
            backup.compare(f"{DATABASE}/{SQLITE_FILE}", _unfinished(file))
        for path in [path for path in backup.sums if file is None and path.startswith(f"{DATABASE}/")]:
            backup.compare(path)
        with (
            closing(Database(make_engine(to_url, settings.database_password_file))) as database,
            database.filled(backup.manifest.revision, fill) as session,
        ):
            for table in NOT_RESTORED:
                session.execute(delete(table))
            now = datetime.now(UTC)
            record_restored(
                session, now, {"taken_at": backup.manifest.taken_at.isoformat(), "backup": backup.folder.name}
            )
            continue_counting(session.connection())
            # The workers of the jobs that were running do not exist here.
            for job in session.scalars(select(JobRow).where(JobRow.state == JobState.RUNNING)).all():
                record(session, now, event_kinds.GIVEN_BACK, job)
                requeue(job)
            write_identity(session, folder, uuid4().hex)
            # The commit or the renaming of SQLite's file may succeed and then report an error: a retry finds out.
            decided = True
        if file is not None:
            _put_in_place(_unfinished(file), file)
    except BaseException:
        if not decided:
            _clear(folder, settings)
            (folder / RESTORING).unlink()
        raise


def _unfinished(file: Path) -> Path:
    """Return the name of SQLite's file until all rows are in the file."""
    return file.with_name(f"{file.name}.restoring")


def _put_in_place(unfinished: Path, file: Path) -> None:
    with closing(sqlite3.connect(unfinished)) as connection:
        busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    if busy or file.exists():
        raise BackupRefused(f"another process uses {str(file)!r}: end it, and restore once more")
    unfinished.with_name(f"{unfinished.name}.lock").unlink()
    flush(unfinished)
    unfinished.rename(file)
    flush(file.parent)


def _identity_in_database(settings: StorageSettings) -> str | None:
    """Return the identity of the data folder in a database, empty if it has none; None: there are no tables."""
    file = settings.database_file
    if file is not None and not file.exists():
        return None
    with (
        closing(Database(make_engine(settings.url, settings.database_password_file))) as database,
        database.snapshot() as connection,
    ):
        if inspect(connection).has_table(DataFolderRow.__tablename__):
            return connection.scalar(select(DataFolderRow.identity)) or ""
        return "" if has_tables(connection) or file is not None else None


def _clear(folder: Path, settings: StorageSettings) -> None:
    """Remove what a restore has written so far into a folder that was empty."""
    for path in folder.iterdir():
        if path.name not in {*_NOTHING, RESTORING}:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    if (file := settings.database_file) is not None:
        for path in file.parent.glob(f"{_unfinished(file).name}*"):
            path.unlink()


def _checked(folder: Path, settings: StorageSettings) -> Backup:
    backup = Backup(folder)
    manifest = backup.manifest
    if not is_known(manifest.revision):
        theirs = f"version {manifest.version} with tables of revision {manifest.revision}"
        ours = f"version {VERSION}, knows revision {newest_revision()}"
        msg = f"the backup was taken by {theirs}, and this program, {ours}: install version {manifest.version}"
        raise BackupRefused(msg)
    if (manifest.database == "sqlite") != settings.is_one_file:
        msg = f"the backup is of a database of the kind {manifest.database}, and SAWMILL_DATABASE_URL names another"
        raise BackupRefused(f"{msg}: restore it into one of its own kind")
    if problems := list(backup.misplaced().values()):
        more = f" (and {len(problems) - 1} more: sawmill restore --check names them)" if len(problems) > 1 else ""
        raise Damaged(f"{problems[0]}{more}")
    return backup
