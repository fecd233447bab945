"""Restoring a backup into an empty data folder and an empty database, of either kind.

All files are copied to `restoring/` in the data folder first, and no store opens while that folder exists. Then the
files are moved to their places, the rows are committed, and the folder is removed. After a kill the command is given
again: if the rows were committed, only the folder has to be removed; otherwise the restore starts again.
"""

import fcntl
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_platform.backups.checking import CheckedBackup, Reporter, compare
from sawmill_platform.backups.copying import check_room_for, copy
from sawmill_platform.backups.manifest import DATA, Entry, Manifest, folders, open_plain
from sawmill_platform.backups.row_contracts import Readers, refuse_unfit_row
from sawmill_platform.backups.rows import go_on_counting, read_rows
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.database import Database, has_tables, is_known, newest_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import JobRow
from sawmill_platform.errors import BackupRefused, Damaged
from sawmill_platform.files.file_store import IDENTITY, RESTORING, FileStore
from sawmill_platform.files.folder_identity import write_identity
from sawmill_platform.files.whole_files import flush, flushed_file_system
from sawmill_platform.jobs.job_store import requeue
from sawmill_platform.ledger.events import record, record_restored
from sawmill_platform.settings import StorageSettings
from sawmill_vocabulary import ProgressCallback
from sawmill_vocabulary.version import VERSION

_LOCK = "lock"
# Names that an empty data folder may have: the folder of a separate disk, and the lock of the service.
_NOTHING = {"lost+found", "serve.lock"}


def check_empty(settings: StorageSettings) -> bool:
    """Check that a restore may start; the remains of a killed restore are allowed.

    Returns
    -------
    bool
        True if a killed restore had committed all rows.

    Raises
    ------
    BackupRefused
        The data folder or the database is not empty.
    StorageUnavailable
        The database does not answer.
    """
    folder, file = settings.data_folder, settings.database_file
    was_started = (folder / RESTORING).exists()
    names = sorted({path.name for path in folder.iterdir()} - _NOTHING) if folder.is_dir() and not was_started else []
    if names:
        msg = f"{str(folder)!r} is not empty ({', '.join(names[:3])}): a backup is restored into an empty folder alone"
        raise BackupRefused(msg)
    is_filled = _is_filled(settings)
    if is_filled and not (was_started and _is_emptied(folder / RESTORING / DATA)):
        where = "the database of SAWMILL_DATABASE_URL" if file is None else repr(str(file))
        raise BackupRefused(f"{where} is not empty: a backup is restored into an empty database alone")
    return is_filled


def restore(
    backup: Path, settings: StorageSettings, on_progress: ProgressCallback, *, readers: Readers
) -> Manifest | None:
    """Restore a backup, compare every sum, and read every row by its contract.

    Returns
    -------
    Manifest or None
        Manifest of the backup. None: an earlier command had restored everything before it was killed, and this command
        removed the remains.

    Raises
    ------
    BackupRefused
        The folder or the database is not empty, another restore is running, or the backup is of a later version.
    Damaged
        The backup is not as it was written: nothing is restored.
    StorageFull, StorageUnavailable, OSError
        The data folder or the database cannot be written to: nothing is restored.
    """
    checked, is_filled = _checked(backup), check_empty(settings)
    folder = settings.data_folder.absolute()
    with _alone_in(folder):
        if is_filled:
            manifest = None
        else:
            manifest = checked.manifest
            _clear(folder, settings)
            _restore(checked, folder, settings, readers, on_progress)
        shutil.rmtree(folder / RESTORING)
    FileStore(folder).make_folders()
    flush(folder)
    return manifest


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep stores of the folder from opening, even after this process was killed, and lock out other restores."""
    (folder / RESTORING).mkdir(parents=True, exist_ok=True)
    flush(folder)
    with (folder / RESTORING / _LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BackupRefused(f"another restore into {str(folder)!r} goes on: wait for it") from error
        yield


def _restore(
    backup: CheckedBackup, folder: Path, settings: StorageSettings, readers: Readers, on_progress: ProgressCallback
) -> None:
    manifest, decided = backup.manifest, False
    file = settings.database_file
    to_url = settings.url if file is None else f"sqlite:///{_unfinished(file)}"
    target = Database(make_engine(to_url, settings.database_password_file))
    try:
        with flushed_file_system(folder / RESTORING):
            _copy_files(backup, folder / RESTORING / DATA, settings.disk_reserve_bytes, on_progress)
        with target.filled(manifest.revision, lambda to: read_rows(to, backup.folder, manifest.tables)) as session:
            refuse_unfit_row(session, backup.folder, readers)
            _take_jobs_back(session, backup)
            write_identity(session, folder / RESTORING / DATA, uuid4().hex)
            for path in (folder / RESTORING / DATA).iterdir():
                path.rename(folder / path.name)
            flush(folder)
            # The commit or the renaming of SQLite's file may succeed and then report an error: a retry finds out.
            decided = True
        target.engine.dispose()
        if file is not None:
            _put_in_place(_unfinished(file), file)
    except BaseException:
        target.engine.dispose()
        if not decided:
            _clear(folder, settings)
            shutil.rmtree(folder / RESTORING)
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
    unfinished.rename(file)
    flush(file.parent)


def _is_filled(settings: StorageSettings) -> bool:
    """Return whether the database has tables; SQLite's file is not created by the check."""
    if settings.database_file is not None:
        return settings.database_file.exists()
    database = Database(make_engine(settings.url, settings.database_password_file))
    try:
        with database.snapshot() as connection:
            return has_tables(connection)
    finally:
        database.engine.dispose()


def _is_emptied(data: Path) -> bool:
    """Return whether all files were moved, which happens before the commit; otherwise the rows are not of a restore."""
    return not any(data.glob("*"))


def _clear(folder: Path, settings: StorageSettings) -> None:
    """Remove the files that a restore has written so far."""
    for path in (*(folder / name for name in folders()), folder / RESTORING / DATA):
        if path.exists():
            shutil.rmtree(path)
    (folder / IDENTITY).unlink(missing_ok=True)
    if (file := settings.database_file) is not None:
        for path in file.parent.glob(f"{_unfinished(file).name}*"):
            path.unlink()


def _checked(backup: Path) -> CheckedBackup:
    checked = CheckedBackup(backup)
    if not is_known(checked.manifest.revision):
        theirs = f"version {checked.manifest.version} with tables of revision {checked.manifest.revision}"
        ours = f"version {VERSION}, knows revision {newest_revision()}"
        msg = f"the backup was taken by {theirs}, and this program, {ours}: install version {checked.manifest.version}"
        raise BackupRefused(msg)
    problems = list(checked.problems().values())
    if problems:
        more = f" (and {len(problems) - 1} more: sawmill restore --check names them)" if len(problems) > 1 else ""
        raise Damaged(f"{problems[0]}{more}")
    return checked


def _copy_files(backup: CheckedBackup, into: Path, reserve_bytes: int, on_progress: ProgressCallback) -> None:
    into.mkdir()
    check_room_for(into, sum(_sizes(backup).values()), "the restored service", reserve_bytes=reserve_bytes)
    report = Reporter(backup.entries, on_progress)
    names = dict[tuple[int, str], Path]()
    for entry in backup.entries:
        target = into / entry.path
        target.parent.mkdir(parents=True, exist_ok=True)
        if entry.sha256 is None:
            target.mkdir()
            continue
        status = backup.statuses[f"{DATA}/{entry.path}"]
        if (twin := names.get((status.st_ino, entry.sha256))) is not None:
            with suppress(OSError):  # no links: it is copied
                target.hardlink_to(twin)
                report(entry.size_bytes)
                continue
        _copy(backup.folder, entry, target, report)
        if status.st_nlink > 1:
            names[status.st_ino, entry.sha256] = target


def _sizes(backup: CheckedBackup) -> dict[object, int]:
    """Return the size of every file, once for a file with several names."""
    return {status.st_ino: status.st_size for status in backup.statuses.values()}


def _copy(backup: Path, entry: Entry, target: Path, report: Reporter) -> None:
    with open_plain(backup / DATA / entry.path) as reading:
        compare(entry, copy(reading, target, report, mtime_ns=entry.mtime_ns))


def _take_jobs_back(session: Session, backup: CheckedBackup) -> None:
    """Queue the jobs that were running, because their workers do not exist here."""
    now = datetime.now(UTC)
    record_restored(session, now, {"taken_at": backup.manifest.taken_at.isoformat(), "backup": backup.folder.name})
    go_on_counting(session.connection())
    for job in session.scalars(select(JobRow).where(JobRow.state == JobState.RUNNING)).all():
        record(session, now, event_kinds.GIVEN_BACK, job)
        requeue(job)
