"""Check of a whole backup: every file is read and every sum compared; no file may be missing or added."""

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

from sawmill_platform.backups.manifest import (
    DATA,
    MANIFEST,
    MANIFEST_SUM,
    Entry,
    Manifest,
    Summed,
    read_entries,
    read_manifest,
    summed,
)
from sawmill_platform.errors import Damaged
from sawmill_vocabulary import Progress, ProgressCallback


class CheckedBackup:
    """A backup whose manifest, rows and list of files are intact, and the files in the folder of the backup.

    Parameters
    ----------
    folder
        Folder of the backup.

    Attributes
    ----------
    manifest : Manifest
        Manifest of the backup.
    entries : list of Entry
        Entries of the files of the backup.
    statuses : mapping
        Status of every file in the folder, by path; folders are left out.

    Raises
    ------
    Damaged
        The folder is no backup, or manifest, rows or list of files are damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest: Manifest = read_manifest(folder)
        self.statuses: Mapping[str, os.stat_result] = dict(_all_below(folder, ""))
        for path, expected in self.manifest.parts().items():
            _compare(path, summed(folder / path), expected.sha256)
        self.entries = list(read_entries(folder))

    def problems(self) -> dict[str, str]:
        """Find paths that are missing, added, no files or of another size; a sentence by path. No file is read."""
        files = {f"{DATA}/{entry.path}": entry for entry in self.entries if entry.sha256 is not None}
        more = self.statuses.keys() - files.keys() - {MANIFEST, MANIFEST_SUM, *self.manifest.parts()}
        found = {path: f"{path} is not in the manifest" for path in more}
        for path, entry in files.items():
            status = self.statuses.get(path)
            if status is None:
                found[path] = f"{path} is missing"
            elif not stat.S_ISREG(status.st_mode):
                found[path] = f"{path} is no file, but a link or a device"
            elif status.st_size != entry.size_bytes:
                found[path] = f"{path} has {status.st_size} bytes, and the manifest has {entry.size_bytes}"
        return dict(sorted(found.items()))


def check_backup(folder: Path, on_progress: ProgressCallback) -> tuple[Manifest, list[str]]:
    """Read a whole backup.

    Returns
    -------
    tuple of Manifest and list of str
        Manifest, and a sentence for each file that is missing, added, or not as it was written.

    Raises
    ------
    Damaged
        The folder is no backup, or manifest, rows or list of files are damaged.
    """
    backup = CheckedBackup(folder)
    problems = backup.problems()
    readable = [entry for entry in backup.entries if entry.sha256 and f"{DATA}/{entry.path}" not in problems]
    report = Reporter(readable, on_progress)
    for entry in readable:
        try:
            compare(entry, summed(folder / DATA / entry.path, report))
        except Damaged as error:
            problems[entry.path] = str(error)
    return backup.manifest, list(problems.values())


def compare(entry: Entry, found: Summed) -> None:
    """Check a file of a backup against its entry.

    Raises
    ------
    Damaged
        The file differs from its entry.
    """
    _compare(f"{DATA}/{entry.path}", found, entry.sha256)


class Reporter:
    """Report of progress by the bytes of files that were read."""

    def __init__(self, entries: list[Entry], on_progress: ProgressCallback) -> None:
        self._read, self._all = 0, sum(entry.size_bytes for entry in entries)
        self._on_progress = on_progress

    def __call__(self, size_bytes: int) -> None:
        """Count further bytes that were read."""
        self._read += size_bytes
        stage = f"{self._read / 1e9:.1f} of {self._all / 1e9:.1f} GB"
        self._on_progress(Progress(fraction=min(self._read / max(self._all, 1), 1.0), stage=stage))


def _compare(path: str, found: Summed, expected: str | None) -> None:
    if found.sha256 != expected:
        raise Damaged(f"{path} is damaged: its SHA-256 is {found.sha256}, and the backup was written with {expected}")


def _all_below(folder: Path, prefix: str) -> Iterator[tuple[str, os.stat_result]]:
    """Yield path and status of every file in a backup; no link is followed, so that nothing outside is read."""
    with os.scandir(folder / prefix) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _all_below(folder, f"{prefix}{entry.name}/")
            else:
                yield f"{prefix}{entry.name}", entry.stat(follow_symlinks=False)
