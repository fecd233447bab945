"""Detection of complete files in a folder: size and time are constant, or a `.done` file exists.

Shares of other machines do not notify changes, so a folder is inspected repeatedly. The time for which a file has been
constant is measured by the monotonic clock; times of files are compared with each other, never with a clock.
"""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from sawmill_worker.watching.durable import Signature, signature
from sawmill_worker.watching.news import News
from sawmill_worker.watching.settings import WatchedFolder

# Bytes reserved for additions to a name, such as `.reason.txt` or `-2`; file systems allow 255 bytes.
LONGEST_NAME_BYTES = 200
# Age, s, after which a `.done` file is removed whose file was taken before the `.done` file came.
_ORPHAN_S = 60.0
_UNFINISHED = (".tmp", ".part", ".filepart", ".crdownload", "~")


@dataclass(frozen=True)
class FileLook:
    """State of a file, and when the state was first seen."""

    signature: Signature
    since_s: float
    number: int = 1


class Looks:
    """Repeated inspection of one folder.

    Parameters
    ----------
    settings
        Settings of the folder.
    news
        Reports the files that are ignored, and files that cannot be read.
    now_s
        A clock that never goes back.
    """

    def __init__(self, settings: WatchedFolder, news: News, now_s: Callable[[], float] = time.monotonic) -> None:
        self._settings = settings
        self._news = news
        self._now_s = now_s
        self._looks: dict[str, FileLook] = {}
        self._left_alone: set[str] = set()
        self._orphans: dict[str, float] = {}
        # Files that may be taken, and files that are still awaited.
        self.whole: dict[str, Signature] = {}
        self.growing: set[str] = set()

    def look(self) -> None:
        """Inspect all files once.

        Raises
        ------
        OSError
            The folder cannot be read.
        """
        names = {path.name for path in self._settings.path.iterdir()}
        looks: dict[str, FileLook] = {}
        self.whole, self.growing = {}, set()
        for name in sorted(names):
            if self._is_watched(name):
                self._look_at(name, names, looks)
        for gone in self._looks.keys() - looks.keys() - names:
            self._news.forget(str(self._settings.path / gone))
        self._looks = looks
        self._left_alone &= names
        self._remove_orphans(names)

    def marker(self, name: str) -> Path | None:
        """Return the path of the mark that declares a file complete; None if the folder uses no marks."""
        suffix = self._settings.done_suffix
        return None if suffix is None else self._settings.path / f"{name}{suffix}"

    def _look_at(self, name: str, names: set[str], looks: dict[str, FileLook]) -> None:
        path = self._settings.path / name
        try:
            seen = signature(path)
            marked = self._is_marked(name, names, seen)
        except FileNotFoundError:  # gone since the listing
            return
        except OSError as error:
            self._news.trouble(str(path), "unreadable", f"it cannot be read: {error.strerror}")
            self.growing.add(name)
            return
        self._news.over(str(path))
        before = self._looks.get(name)
        same = before is not None and before.signature == seen
        look = FileLook(seen, before.since_s, before.number + 1) if before and same else FileLook(seen, self._now_s())
        looks[name] = look
        if marked or self._is_still(look):
            self.whole[name] = seen
        else:
            self.growing.add(name)

    def _is_still(self, look: FileLook) -> bool:
        """Return whether a file is constant; an empty file has just been created by its writer."""
        still_for_s = self._settings.still_for_s
        if still_for_s is None or not look.signature[0]:
            return False
        return look.number > 1 and self._now_s() - look.since_s >= still_for_s

    def _is_marked(self, name: str, names: set[str], seen: Signature) -> bool:
        """Return whether a file is marked; a mark older than the file belongs to an earlier file of the name."""
        marker = self.marker(name)
        if marker is None or marker.name not in names:
            return False
        if marker.is_symlink():
            return self._leave(marker.name, "it is a link, which marks no file as whole")
        return signature(marker)[1] >= seen[1]

    def _is_watched(self, name: str) -> bool:
        suffix = self._settings.done_suffix
        if name.startswith(".") or name.lower().endswith(_UNFINISHED) or (suffix and name.endswith(suffix)):
            return False
        path = self._settings.path / name
        if path in self._own_folders():
            return False
        if path.is_symlink() or not path.is_file():
            reason = "it is a link" if path.is_symlink() else "it is no file: a scan of several is one file, as a ZIP"
            return path.exists() and self._leave(name, reason)
        if self._settings.files_named(name) is None:
            return self._leave(name, "no pattern of the settings matches its name")
        if len(os.fsencode(name)) > LONGEST_NAME_BYTES:
            return self._leave(name, f"its name has more than {LONGEST_NAME_BYTES} bytes")
        return True

    def _own_folders(self) -> Iterator[Path]:
        yield from (self._settings.taken_folder, self._settings.done_folder, self._settings.refused_folder)

    def _leave(self, name: str, reason: str) -> bool:
        if name not in self._left_alone:
            self._left_alone.add(name)
            self._news.warn("left-alone", file=str(self._settings.path / name), reason=reason)
        return False

    def _remove_orphans(self, names: set[str]) -> None:
        """Remove marks that came after their file was taken and would stay forever."""
        suffix = self._settings.done_suffix
        if suffix is None:
            return
        alone = {name for name in names if name.endswith(suffix) and name.removesuffix(suffix) not in {"", *names}}
        # Only marks of watched files are removed: a suffix like `.h5` could belong to scans.
        alone = {name for name in alone if self._settings.files_named(name.removesuffix(suffix)) is not None}
        now_s = self._now_s()
        self._orphans = {name: self._orphans.get(name, now_s) for name in alone}
        for name, since_s in self._orphans.items():
            path = self._settings.path / name
            if now_s - since_s >= max(_ORPHAN_S, self._settings.still_for_s or 0.0) and path.is_file():
                path.unlink(missing_ok=True)
