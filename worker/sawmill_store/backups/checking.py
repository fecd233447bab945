"""Looking whether a backup is what it was: every file read, every sum compared, nothing missing and nothing more."""

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

from sawmill_platform.errors import Damaged
from sawmill_store.backups.manifest import (
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
from sawmill_vocabulary import Progress, ProgressCallback


class Checked:
    """A backup of which manifest, rows and list of files are whole, and whose folder has what it should have.

    Parameters
    ----------
    folder
        Of the backup.

    Attributes
    ----------
    manifest : Manifest
        What it is of.
    entries : list of Entry
        Its files.
    statuses : mapping
        Of all that lies in it, by path in it; folders apart.

    Raises
    ------
    Damaged
        It is no backup, or what tells of its files is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest: Manifest = read_manifest(folder)
        self.statuses: Mapping[str, os.stat_result] = dict(_all_below(folder, ""))
        for path, expected in self.manifest.parts().items():
            _compare(path, summed(folder / path), expected.sha256)
        self.entries = list(read_entries(folder))

    def problems(self) -> dict[str, str]:
        """By path: what is missing, too many, no file or of another size; no file is read for that."""
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
        A sentence for each file that is missing, too many, or another one than was written.

    Raises
    ------
    Damaged
        It is no backup, or what tells of its files is damaged.
    """
    backup = Checked(folder)
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
        It is another one.
    """
    _compare(f"{DATA}/{entry.path}", found, entry.sha256)


class Reporter:
    """Reports progress by the bytes of files that were read."""

    def __init__(self, entries: list[Entry], on_progress: ProgressCallback) -> None:
        self._read, self._all = 0, sum(entry.size_bytes for entry in entries)
        self._on_progress = on_progress

    def __call__(self, size_bytes: int) -> None:
        """Some more were read."""
        self._read += size_bytes
        stage = f"{self._read / 1e9:.1f} of {self._all / 1e9:.1f} GB"
        self._on_progress(Progress(fraction=min(self._read / max(self._all, 1), 1.0), stage=stage))


def _compare(path: str, found: Summed, expected: str | None) -> None:
    if found.sha256 != expected:
        raise Damaged(f"{path} is damaged: its SHA-256 is {found.sha256}, and the backup was written with {expected}")


def _all_below(folder: Path, prefix: str) -> Iterator[tuple[str, os.stat_result]]:
    """What lies in a backup; no link is followed, so that nothing is read that lies elsewhere."""
    with os.scandir(folder / prefix) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _all_below(folder, f"{prefix}{entry.name}/")
            else:
                yield f"{prefix}{entry.name}", entry.stat(follow_symlinks=False)
