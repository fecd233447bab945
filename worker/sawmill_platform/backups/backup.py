"""A backup: a folder with a copy of the database, the files that its rows name, and the sums of both.

SHA256SUMS    SHA-256 and path of every other file, as sha256sum(1) reads them; written last
backup.json   the manifest
database/     sawmill.db of SQLite, or TABLE.csv for each table of PostgreSQL
data/         the files, as in the data folder, without attempts and checkpoints
"""

import hashlib
import os
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO, Literal

from pydantic import Field, ValidationError

from sawmill_platform.contracts.base import Contract, Time
from sawmill_platform.errors import BackupRefused, Damaged
from sawmill_platform.files.whole_files import open_regular
from sawmill_platform.workers.sole_service import HeldByAnother, kernel_lock
from sawmill_vocabulary import Progress, ProgressCallback

SUMS, MANIFEST, DATABASE, DATA = "SHA256SUMS", "backup.json", "database", "data"
_BLOCK_BYTES = 4 * 2**20
# Paths in the backup alone: no part is empty, `.` or `..`, and a file of the data folder lies in a folder there.
_PATH = r"backup\.json|database/[a-z_]+\.(?:csv|db)|data(?:/(?!\.\.?(?:/|$))[^/\\\x00-\x1f]+){2,}"
_LINE = re.compile(rf"([0-9a-f]{{64}})  ({_PATH})")


class Manifest(Contract):
    """Manifest of a backup."""

    # version, revision, database: version of the software that made the backup, migration of the tables, and kind of
    # the database.
    version: str
    revision: str = Field(pattern=r"^[0-9]{4}$")
    database: Literal["sqlite", "postgresql"]
    taken_at: Time  # instant of the rows, by the clock of the machine that made the backup
    lacking: list[str]  # paths of files that rows name and that could not be read


class Backup:
    """A complete backup, read as untrusted input.

    Raises
    ------
    Damaged
        The folder is no backup, or the list of sums or the manifest is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sums = read_sums(folder)  # SHA-256 of each file, by its path in the backup
        self.compare(MANIFEST)
        try:
            self.manifest = Manifest.model_validate_json((folder / MANIFEST).read_bytes())
        except ValidationError as error:
            raise Damaged(f"{MANIFEST} is none of a backup: {' '.join(str(error).split())}") from error

    def compare(self, path: str, target: Path | None = None) -> None:
        """Read a file of the backup, copy it if a target is given, and compare its sum; raise `Damaged`."""
        found, expected = copied(self.folder / path, target), self.sums.get(path)
        if found != expected:
            raise Damaged(f"{path} is damaged: its SHA-256 is {found}, and {SUMS} has {expected}")

    def misplaced(self) -> dict[str, str]:
        """Find paths that are missing, added or no ordinary files; a sentence by path. No file is read."""
        files = dict(_all_below(self.folder, ""))
        found = {path: f"{path} is not in {SUMS}" for path in files.keys() - self.sums.keys() - {SUMS}}
        found |= {path: f"{path} is missing" for path in self.sums.keys() - files.keys()}
        found |= {path: f"{path} is no file, but a link or a device" for path in files if not files[path]}
        return dict(sorted(found.items()))

    def damage(self, on_progress: ProgressCallback) -> list[str]:
        """Read every file; return a sentence for each that is missing, added, or not as it was written."""
        problems = self.misplaced()
        for path in counted(self.sums.keys() - problems.keys(), on_progress):
            try:
                self.compare(path)
            except Damaged as error:
                problems[path] = str(error)
        return list(problems.values())


def read_sums(folder: Path) -> dict[str, str]:
    """Read the list of a backup: SHA-256 by path; raise `Damaged`, also for a path that leaves the backup."""
    if not (folder / SUMS).exists():
        if (folder / "manifest.json").exists():
            raise Damaged(f"{str(folder)!r} is of a development version before 0.2.0: restore it with that version")
        raise Damaged(f"{str(folder)!r} is no backup of this product: it has no {SUMS}")
    with open_plain(folder / SUMS) as file:
        lines = file.read().decode(errors="replace").removesuffix("\n").split("\n")
    sums = dict[str, str]()
    for number, line in enumerate(lines, 1):
        if (found := _LINE.fullmatch(line)) is None:
            raise Damaged(f"line {number} of {SUMS} names no file of a backup: {line:.200}")
        sums[found[2]] = found[1]
    return sums


def open_plain(path: Path) -> BinaryIO:
    """Open an ordinary file; raise `Damaged` for a link, a pipe, a device, or a file that cannot be opened."""
    try:
        return open_regular(path)
    except OSError as error:
        raise Damaged(f"{path} cannot be read as a file: {error.strerror}") from error


def copied(source: Path, target: Path | None = None, most_bytes: int | None = None) -> str:
    """Read a file, copy it with its time of change if a target is given, and return its SHA-256."""
    computed, remaining = hashlib.sha256(), most_bytes
    with open_plain(source) as reading, target.open("xb") if target else nullcontext() as writing:
        mtime_ns = os.fstat(reading.fileno()).st_mtime_ns
        while block := _block(reading, _BLOCK_BYTES if remaining is None else min(remaining, _BLOCK_BYTES)):
            computed.update(block)
            remaining = None if remaining is None else remaining - len(block)
            if writing is not None:
                writing.write(block)
        if writing is not None:
            writing.flush()
            os.utime(writing.fileno(), ns=(mtime_ns, mtime_ns))
    return computed.hexdigest()


def counted(paths: Collection[str], on_progress: ProgressCallback) -> Iterator[str]:
    """Yield paths of files, and report their number."""
    for number, path in enumerate(paths):
        on_progress(Progress(fraction=number / len(paths), stage=f"{number} of {len(paths)} files"))
        yield path


@contextmanager
def alone_with(lock: Path, doing: str) -> Iterator[None]:
    """Hold a lock for the block; raise `BackupRefused` if another process holds it."""
    try:
        with kernel_lock(lock):
            yield
    except HeldByAnother as error:
        raise BackupRefused(f"another {doing} {str(lock.parent)!r} is running: wait for it") from error


def _block(file: BinaryIO, size_bytes: int) -> bytes:
    try:
        return file.read(size_bytes)
    except OSError as error:
        raise Damaged(f"{file.name} cannot be read: {error.strerror}") from error


def _all_below(folder: Path, prefix: str) -> Iterator[tuple[str, bool]]:
    """Yield the path of each file in a backup and whether it is an ordinary one; no link is followed."""
    with os.scandir(folder / prefix) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _all_below(folder, f"{prefix}{entry.name}/")
            else:
                yield f"{prefix}{entry.name}", entry.is_file(follow_symlinks=False)
