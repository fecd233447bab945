"""Taking of a backup while the service runs, into a folder of backups.

Files are never changed once rows name them, but they may be removed. So the rows of one instant are copied first, and
then the named files. If a file has gone since, both steps are repeated, and copied files stay. Each pass copies only
the files that are new since the pass before, so the backup ends soon. The service is never blocked.
"""

import os
import re
import shutil
import stat
import time
from collections.abc import Iterable, Mapping
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from pydantic import ValidationError
from sqlalchemy import inspect

from sawmill_platform.backups import backup
from sawmill_platform.backups.database_copy import write_database
from sawmill_platform.contracts.base import Contract, Time
from sawmill_platform.database.database import Database, known_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import DataFolderRow
from sawmill_platform.errors import BackupRefused, Damaged, StorageUnavailable
from sawmill_platform.files.file_store import LAST_BACKUP, refuse_half_restored
from sawmill_platform.files.folder_identity import check_identity
from sawmill_platform.files.named_folders import Named, NamedFolder, find_named, named_by
from sawmill_platform.files.whole_files import flush_names, flushed_file_system, whole_file
from sawmill_platform.settings import StorageSettings
from sawmill_vocabulary import ProgressCallback
from sawmill_vocabulary.version import VERSION

_NAME = re.compile(r"sawmill-\d{8}T\d{6}Z(-\d+)?")
_LOCK = ".sawmill-backups.lock"
_MOST_PASSES = 20
# Pause for files that are missing because they are being removed: their rows are gone in the next pass.
_PAUSE_S = 1.0
# Some disks and shares round times: NTFS to 100 ns, others to 1 us.
_SAME_TIME_NS = 1000


class Taken(NamedTuple):
    """A complete backup: its folder, its manifest, the number of its files, and the bytes that were not linked."""

    path: Path
    manifest: backup.Manifest
    number_of_files: int
    copied_bytes: int


class Newest(Contract):
    """The last backup of a data folder: its place then, the instant of its rows, and the number of files it lacks."""

    path: str
    taken_at: Time
    lacking: int


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
    StorageUnavailable
        The database does not answer, or the data folder belongs to another database.
    OSError
        The folder cannot be written to, its disk is full, or the data folder cannot be read.
    """
    folder = settings.data_folder.absolute()
    refuse_half_restored(folder)
    if not settings.is_made:
        raise BackupRefused(f"there is no service's data in {str(folder)!r}: give its folder with --data")
    if not into.is_dir():
        raise BackupRefused(f"there is no folder {str(into)!r}: make it once, on the disk that is to hold the backups")
    if into.resolve().is_relative_to(folder.resolve()):
        raise BackupRefused(f"{str(into)!r} lies in the data folder {str(folder)!r}: give a folder on another disk")
    with (
        backup.alone_with(into / _LOCK, "backup into"),
        closing(Database(make_engine(settings.url, settings.database_password_file))) as database,
    ):
        for remains in into.glob(".sawmill-*.partial"):
            shutil.rmtree(remains)
        while (path := into / f"sawmill-{datetime.now(UTC):%Y%m%dT%H%M%SZ}").exists():
            time.sleep(0.1)
        part = _partial(path)
        part.mkdir(mode=0o700)
        try:
            with flushed_file_system(part):
                files = _Files(folder, part, _earlier(into))
                manifest = _fill(database, named, files, on_progress)
        except BaseException:
            shutil.rmtree(part)
            raise
        part.rename(path)
        flush_names(into)
    return Taken(path, manifest, len(files.sums), files.copied_bytes)


def backups_in(into: Path) -> list[Path]:
    """Return the complete backups of a folder, oldest first."""
    return sorted(path for path in into.iterdir() if _NAME.fullmatch(path.name) and path.is_dir())


def remove_older(into: Path, keep: int, taken: Path) -> list[Path]:
    """Remove all but the newest `keep` backups and return them; raise `BackupRefused` while one is being written.

    The backup just taken stays and counts, even where a wrong clock gave other backups later times.
    """
    with backup.alone_with(into / _LOCK, "backup into"):
        earlier = [path for path in backups_in(into) if path.name != taken.name]
        old = earlier[: max(len(earlier) + 1 - keep, 0)]
        for path in old:
            shutil.rmtree(path.rename(_partial(path)))
    return old


def note_newest(folder: Path, taken: Taken) -> None:
    """Write a note of a complete backup into the data folder."""
    manifest = taken.manifest
    note = Newest(path=str(taken.path.absolute()), taken_at=manifest.taken_at, lacking=len(manifest.lacking))
    with whole_file(folder / LAST_BACKUP) as file:
        file.write(note.model_dump_json().encode())


def newest_backup(folder: Path) -> Newest | None:
    """Read the note of the last backup of a data folder; None where there is no readable note."""
    try:
        return Newest.model_validate_json((folder / LAST_BACKUP).read_text())
    except (FileNotFoundError, ValidationError):
        return None


def _partial(path: Path) -> Path:
    """Return the name of a backup until it is complete, and while it is being removed."""
    return path.with_name(f".{path.name}.partial")


def _earlier(into: Path) -> tuple[Path, Mapping[str, str]]:
    """Find the newest readable backup of a folder; return its folder and its sums."""
    for path in reversed(backups_in(into)):
        with suppress(Damaged):  # an older one will do; `restore --check` says what is wrong with it
            return path, backup.read_sums(path)
    return into, {}


def _fill(
    database: Database, folders: Iterable[NamedFolder], files: "_Files", on_progress: ProgressCallback
) -> backup.Manifest:
    """Copy rows and files, and write the manifest and, last of all, the sums."""
    part, lacking_before = files.part, None
    for _ in range(_MOST_PASSES):
        taken_at = datetime.now(UTC)
        revision, named = _copy_rows(database, folders, files)
        found, lacking = find_named(files.folder, named)
        for path in backup.counted(found, on_progress):
            try:
                files.add(path, found[path])
            except Damaged:  # gone, or its disk cannot read it
                lacking.append(path)
        if lacking in ([], lacking_before):
            break
        lacking_before = lacking
        time.sleep(_PAUSE_S)
    else:
        raise StorageUnavailable(f"files went away in each of {_MOST_PASSES} passes over the data folder: try later")
    files.remove_all_but(found)
    kind = "sqlite" if database.engine.dialect.name == "sqlite" else "postgresql"
    manifest = backup.Manifest(version=VERSION, revision=revision, database=kind, taken_at=taken_at, lacking=lacking)
    (part / backup.MANIFEST).write_text(manifest.model_dump_json(indent=1))
    others = [backup.MANIFEST, *(f"{backup.DATABASE}/{path.name}" for path in (part / backup.DATABASE).iterdir())]
    sums = files.sums | {path: backup.copied(part / path) for path in others}
    (part / backup.SUMS).write_text("".join(f"{sums[path]}  {path}\n" for path in sorted(sums)))
    return manifest


def _copy_rows(database: Database, folders: Iterable[NamedFolder], files: "_Files") -> tuple[str, list[Named]]:
    """Copy the rows of this instant, and return their revision and the paths that they name."""
    if (files.part / backup.DATABASE).exists():
        shutil.rmtree(files.part / backup.DATABASE)
    with database.snapshot() as connection:
        revision = known_revision(connection)
        if revision is None:
            raise BackupRefused("the database has no tables: a first start of sawmill serve makes them")
        names = inspect(connection).get_table_names()
        if DataFolderRow.__tablename__ in names:
            check_identity(connection, files.folder)
        write_database(connection, files.part / backup.DATABASE)
        return revision, named_by(connection, folders, names)


class _Files:
    """Files of a backup: second names (hard links) of an earlier backup's unchanged files, and copies of the others.

    A file is unchanged if size and time of change are those of its copy; neither is read again.
    """

    def __init__(self, folder: Path, part: Path, earlier: tuple[Path, Mapping[str, str]]) -> None:
        self.folder, self.part = folder, part
        self.sums: dict[str, str] = {}
        self.copied_bytes = 0
        # Copies by path, and of files with several names in the data folder, such as an upload that two jobs read.
        earlier_folder, sums = earlier
        self._copies: dict[object, tuple[Path, str]] = {name: (earlier_folder / name, sums[name]) for name in sums}

    def add(self, path: str, most_bytes: int | None) -> None:
        """Link or copy a file, or raise `Damaged` if it has gone or cannot be read."""
        name, target = f"{backup.DATA}/{path}", self.part / backup.DATA / path
        try:
            status = (self.folder / path).stat()
        except FileNotFoundError as error:
            raise Damaged(f"{path} is missing") from error
        size_bytes = status.st_size if most_bytes is None else min(status.st_size, most_bytes)
        if name in self.sums:
            if _is_copy(target, size_bytes, status):
                return
            self._remove(name)
        target.parent.mkdir(parents=True, exist_ok=True)
        inode = (status.st_dev, status.st_ino)
        for source, known_sum in (self._copies[key] for key in (name, inode) if key in self._copies):
            with suppress(OSError):  # no links, too many of them, or the earlier backup lacks it: it is copied
                if _is_copy(source, size_bytes, status):
                    target.hardlink_to(source)
                    self.sums[name] = known_sum
                    break
        else:
            try:
                self.sums[name] = backup.copied(self.folder / path, target, most_bytes)
            except Damaged:
                target.unlink(missing_ok=True)
                raise
            self.copied_bytes += size_bytes
        self._copies[inode] = target, self.sums[name]

    def remove_all_but(self, found: Iterable[str]) -> None:
        """Remove files that the last pass did not find."""
        for name in self.sums.keys() - {f"{backup.DATA}/{path}" for path in found}:
            self._remove(name)

    def _remove(self, name: str) -> None:
        (self.part / name).unlink()
        del self.sums[name]


def _is_copy(copy: Path, size_bytes: int, status: os.stat_result) -> bool:
    """Return whether a copy is of a file as it is now: files never change without their time."""
    made = copy.lstat()
    is_of_time = abs(made.st_mtime_ns - status.st_mtime_ns) <= _SAME_TIME_NS
    return stat.S_ISREG(made.st_mode) and made.st_size == size_bytes and is_of_time
