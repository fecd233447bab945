"""Folders of backups: one backup is written at a time, and the remains of a killed backup are removed."""

import fcntl
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from sawmill_platform.errors import BackupRefused

_NAME = re.compile(r"sawmill-\d{8}T\d{6}Z(-\d+)?")
_PARTIAL = ".partial"
_LOCK = ".sawmill-backups.lock"


@contextmanager
def alone_in(into: Path) -> Iterator[None]:
    """Lock a folder, so that no other process writes backups into the folder.

    Raises
    ------
    BackupRefused
        Another process writes a backup.
    """
    with (into / _LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BackupRefused(f"another backup into {str(into)!r} is being written: wait for it") from error
        for remains in into.glob(f".sawmill-*{_PARTIAL}"):
            shutil.rmtree(remains)
        yield


def backups_in(into: Path) -> list[Path]:
    """Return the complete backups of a folder, oldest first."""
    return sorted(path for path in into.iterdir() if _NAME.fullmatch(path.name) and path.is_dir())


def new_name(into: Path, taken_at: datetime) -> Path:
    """Return a new name for a backup that starts now."""
    first = into / f"sawmill-{taken_at:%Y%m%dT%H%M%SZ}"
    path, number = first, 1
    while path.exists():
        number += 1
        path = first.with_name(f"{first.name}-{number}")
    return path


def partial_of(path: Path) -> Path:
    """Return the name of a backup until it is complete, and while it is being removed."""
    return path.with_name(f".{path.name}{_PARTIAL}")


def remove_older(into: Path, keep: int, taken: Path) -> list[Path]:
    """Remove all backups but the newest ones; other backups that share files with the removed ones stay whole.

    Parameters
    ----------
    taken
        The backup just taken: it stays and counts, even where a wrong clock gave other backups later times.

    Returns
    -------
    list of Path
        Backups that were removed.

    Raises
    ------
    BackupRefused
        Another backup is being written into the folder.
    """
    with alone_in(into):
        earlier = [path for path in backups_in(into) if path.name != taken.name]
        old = earlier[: max(len(earlier) + 1 - keep, 0)]
        for path in old:
            path.rename(partial_of(path))
            shutil.rmtree(partial_of(path))
    return old
