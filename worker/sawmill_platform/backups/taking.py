"""Taking of a backup while the service runs.

Files are never changed once rows name them, but they may be removed. So the rows of one instant are read first, and
then the named files are copied. If a file has gone since, both steps are repeated, and copied files stay. Each pass
copies only the files that are new since the pass before, so the backup ends soon. The service is never blocked.
"""

import shutil
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import inspect

from sawmill_platform.backups.folders import alone_in, backups_in, new_name, partial_of
from sawmill_platform.backups.laying import Laying
from sawmill_platform.backups.manifest import (
    DATA,
    FILES,
    ROWS,
    Entry,
    Manifest,
    Table,
    read_entries,
    read_manifest,
    summed,
    write_entry,
    write_manifest,
)
from sawmill_platform.backups.named_files import Named, look_for, named_by
from sawmill_platform.backups.rows import write_rows
from sawmill_platform.database.database import Database, known_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import DataFolderRow
from sawmill_platform.errors import BackupRefused, Damaged, StorageUnavailable
from sawmill_platform.files.file_store import refuse_half_restored
from sawmill_platform.files.folder_identity import check_identity
from sawmill_platform.files.named_folders import NamedFolder
from sawmill_platform.files.whole_files import flush_names, flushed_file_system
from sawmill_platform.settings import StorageSettings
from sawmill_vocabulary import ProgressCallback
from sawmill_vocabulary.version import VERSION

_MOST_LOOKS = 20
# Pause for files that are missing because they are being removed: their rows are gone in the next pass.
_PAUSE_S = 1.0


class Taken(NamedTuple):
    """A complete backup.

    Attributes
    ----------
    path : Path
        Folder of the backup.
    manifest : Manifest
        Manifest of the backup.
    copied_bytes : int
        Bytes of the copied files; all other files are second names of an earlier backup's files.
    """

    path: Path
    manifest: Manifest
    copied_bytes: int


def take_backup(
    settings: StorageSettings, into: Path, on_progress: ProgressCallback, *, named: Iterable[NamedFolder]
) -> Taken:
    """Take a backup into an existing folder, under a name with the time of the backup.

    Parameters
    ----------
    named
        Folders in which rows name files.

    Raises
    ------
    BackupRefused
        There is nothing to back up, the folder does not exist or is in the data folder, or another backup is running.
    StorageFull, StorageUnavailable
        The disk has no room, the database does not answer, or the data folder belongs to another database.
    OSError
        The folder cannot be written to, or the data folder cannot be read.
    """
    folder = settings.data_folder.absolute()
    _check(settings, folder, into)
    with alone_in(into):
        path = new_name(into, datetime.now(UTC))
        part = partial_of(path)
        part.mkdir(mode=0o700)
        database = Database(make_engine(settings.url, settings.database_password_file))
        try:
            with flushed_file_system(part):
                laying = Laying(folder, part / DATA, _earlier(into), on_progress)
                manifest = _fill(database, named, part, laying)
        except BaseException:
            shutil.rmtree(part)
            raise
        finally:
            database.engine.dispose()
        part.rename(path)
        flush_names(into)
    return Taken(path, manifest, laying.copied_bytes)


def _check(settings: StorageSettings, folder: Path, into: Path) -> None:
    refuse_half_restored(folder)
    if not settings.is_made:
        raise BackupRefused(f"there is no service's data in {str(folder)!r}: give its folder with --data")
    if not into.is_dir():
        msg = f"there is no folder {str(into)!r}: make it once, on the disk that is to hold the backups"
        raise BackupRefused(msg)
    if into.resolve().is_relative_to(folder.resolve()):
        msg = f"{str(into)!r} lies in the data folder {str(folder)!r}: give a folder on another disk"
        raise BackupRefused(msg)


def _earlier(into: Path) -> tuple[Path, Mapping[str, Entry]]:
    """Find the newest readable backup of a folder; return the folder of the files, and the entries by path."""
    for path in reversed(backups_in(into)):
        with suppress(Damaged):  # an older one will do; `restore --check` says what is wrong with it
            manifest = read_manifest(path)
            if summed(path / FILES) == manifest.files:
                return path / DATA, {entry.path: entry for entry in read_entries(path)}
    return into, {}


def _fill(database: Database, folders: Iterable[NamedFolder], part: Path, laying: Laying) -> Manifest:
    lacking_before: list[str] = []
    for _ in range(_MOST_LOOKS):
        taken_at = datetime.now(UTC)
        tables, revision, named = _look(database, folders, part, laying.folder)
        found, lacking = look_for(laying.folder, named)
        went, unreadable = laying.lay(found)
        lacking += unreadable
        if not went and lacking in ([], lacking_before):
            break
        lacking_before = lacking
        time.sleep(_PAUSE_S if lacking else 0.0)
    else:
        raise StorageUnavailable(f"files went away at each of {_MOST_LOOKS} looks at the data folder: try again later")
    entries = laying.only(found)
    with (part / FILES).open("xb") as file:
        file.writelines(map(write_entry, entries))
    manifest = Manifest(
        version=VERSION,
        revision=revision,
        database="sqlite" if database.engine.dialect.name == "sqlite" else "postgresql",
        taken_at=taken_at,
        tables=tables,
        files=summed(part / FILES),
        number_of_files=len(entries),
        bytes_of_files=sum(entry.size_bytes for entry in entries),
        lacking=lacking,
    )
    write_manifest(part, manifest)
    return manifest


def _look(
    database: Database, folders: Iterable[NamedFolder], part: Path, folder: Path
) -> tuple[dict[str, Table], str, list[Named]]:
    """Write the rows of this instant, and return tables, revision and the paths that the rows name."""
    if (part / ROWS).exists():
        shutil.rmtree(part / ROWS)
    with database.snapshot() as connection:
        revision = known_revision(connection)
        if revision is None:
            raise BackupRefused("the database has no tables: a first start of sawmill serve makes them")
        names = inspect(connection).get_table_names()
        if DataFolderRow.__tablename__ in names:
            check_identity(connection, folder)
        tables = write_rows(connection, part)
        return tables, revision, named_by(connection, folders, names)
