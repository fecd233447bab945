"""Writing of files into a backup, as second names (hard links) of existing files where possible."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from sawmill_platform.backups.copying import check_room_for, copy, has_links
from sawmill_platform.backups.manifest import Entry
from sawmill_platform.backups.named_files import Found
from sawmill_platform.errors import Damaged
from sawmill_vocabulary import Progress, ProgressCallback


class Laying:
    """Writer of files into a backup, in one pass or in several.

    Parameters
    ----------
    folder, into
        Folder of the files, and folder of the backup, which is made here.
    earlier
        Folder of the files of an earlier backup, and the entries of these files by path.
    on_progress
        Function that is called after each file, and during long files.

    Attributes
    ----------
    copied_bytes : int
        Bytes that were copied so far.
    """

    def __init__(
        self, folder: Path, into: Path, earlier: tuple[Path, Mapping[str, Entry]], on_progress: ProgressCallback
    ) -> None:
        self.folder = folder
        self.copied_bytes = 0
        self._into = into
        self._into.mkdir()
        self._earlier_folder, self._earlier = earlier if has_links(into) else (into, {})
        self._on_progress = on_progress
        self._laid: dict[str, Entry] = {}
        self._made_folders = set[str]()
        # Entries of files with several names in the data folder, such as an upload that two jobs read.
        self._names: dict[tuple[int, int], Entry] = {}

    def lay(self, found: list[Found]) -> tuple[bool, list[str]]:
        """Write the files not yet in the backup; return whether a file has gone, and the paths of unreadable files."""
        new = [file for file in found if not _same(self._laid.get(file.path), file)]
        # A file with several names is copied once.
        to_copy = {
            file.inode or file.path: file.size_bytes for file in new if not _same(self._earlier.get(file.path), file)
        }
        check_room_for(self._into, sum(to_copy.values()), "the backup")
        self._end_bytes = self.copied_bytes + sum(to_copy.values())
        has_gone, unreadable = False, list[str]()
        for number, file in enumerate(new):
            self._stage = f"{number} of {len(new)} files"
            self._count(0)
            try:
                self._laid[file.path] = self._lay(file)
            except _Gone:
                has_gone = True
            except Damaged:
                unreadable.append(file.path)
        return has_gone, unreadable

    def only(self, found: list[Found]) -> list[Entry]:
        """Remove files that the last pass did not find; return the entries of the files found."""
        for path in self._laid.keys() - {file.path for file in found}:
            self._remove(self._into / path)
        return [self._laid[file.path] for file in found if file.path in self._laid]

    def _lay(self, file: Found) -> Entry:
        if self._laid.pop(file.path, None) is not None:
            self._remove(self._into / file.path)
        parent = file.path.rpartition("/")[0]
        if parent not in self._made_folders:
            (self._into / parent).mkdir(parents=True, exist_ok=True)
            self._made_folders.add(parent)
        if file.status is None:
            (self._into / file.path).mkdir()
            return Entry(file.path, 0, 0, None)
        entry = self._linked(file) or self._copied(file)
        if file.inode is not None:
            self._names[file.inode] = entry
        return entry

    def _linked(self, file: Found) -> Entry | None:
        """Link a file to an existing copy; None where there is no copy, or the file system has no links."""
        # Strings are used: for many small files, `Path` objects would take as long as the system calls.
        before = self._earlier.get(file.path)
        twin = None if file.inode is None else self._names.get(file.inode)
        for source, entry in ((self._earlier_folder, before), (self._into, twin)):
            if entry is not None and _same(entry, file):
                with suppress(OSError):  # no links, too many of them, or the earlier backup lacks it: it is copied
                    if os.lstat(f"{source}/{entry.path}").st_size == file.size_bytes:
                        os.link(f"{source}/{entry.path}", f"{self._into}/{file.path}", follow_symlinks=False)
                        return entry._replace(path=file.path)
        return None

    def _copied(self, file: Found) -> Entry:
        target = self._into / file.path
        try:
            reading = (self.folder / file.path).open("rb")
        except FileNotFoundError as error:
            raise _Gone from error
        with reading:
            mtime_ns = os.fstat(reading.fileno()).st_mtime_ns
            try:
                made = copy(reading, target, self._count, mtime_ns=mtime_ns, most_bytes=file.most_bytes)
            except Damaged:
                target.unlink()
                raise
        return Entry(file.path, made.size_bytes, mtime_ns, made.sha256)

    def _count(self, copied_bytes: int) -> None:
        self.copied_bytes += copied_bytes
        fraction = self.copied_bytes / self._end_bytes if self._end_bytes else 1.0
        self._on_progress(Progress(fraction=min(fraction, 1.0), stage=self._stage))

    def _remove(self, path: Path) -> None:
        path.rmdir() if path.is_dir() else path.unlink()


class _Gone(Exception):  # noqa: N818 - an outcome
    """A file has been removed since it was found."""


def _same(entry: Entry | None, file: Found) -> bool:
    """Return whether an entry is of a file as it is now: files never change without their time."""
    if entry is None or file.status is None:
        return entry is not None and entry.sha256 is None and file.status is None
    return (entry.size_bytes, entry.mtime_ns) == (file.size_bytes, file.status.st_mtime_ns) and entry.sha256 is not None
