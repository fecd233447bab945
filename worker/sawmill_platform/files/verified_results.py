"""Verification of results: the content of a file is compared with the digest in its job's row before it is parsed.

A library in C may loop or crash on one changed byte, and would stop the whole process with it.
"""

import hashlib
import os
import stat
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from sawmill_platform.errors import DamagedResult
from sawmill_platform.files.whole_files import open_regular

# A file system's clock ticks every 4 ms or so: two changes within a tick leave the same times.
_SETTLED_NS = 100_000_000

# Device, inode, size, and times of the last change of content and of status, which no writer can keep.
FileIdentity: TypeAlias = tuple[int, int, int, int, int]


class _Verification:
    """The newest verification of a file: identity, digest, and why the file is not the one that the job wrote."""

    def __init__(self) -> None:
        self.lock = threading.Lock()  # one thread reads the file, and the rest wait for it
        self.outcome: tuple[FileIdentity, bytes, str | None] | None = None


class VerifiedResults:
    """Verification of the results of jobs, at their first use in this process; threads may share it."""

    def __init__(
        self,
        noted: Callable[[Path], bytes | None],
        read_apart: Callable[[Path], None],
        note: Callable[[Path, bytes], None],
        *,
        most_files: int = 10_000,
    ) -> None:
        self._noted, self._read_apart, self._note = noted, read_apart, note
        self._most_files = most_files
        self._lock = threading.Lock()
        self._files: OrderedDict[Path, _Verification] = OrderedDict()

    def digest(self, path: Path) -> bytes:
        """Return the sha256 of a result, verified since the file's last change; takes as long as reading the file."""
        with self._lock:
            verification = self._files.setdefault(path, _Verification())
            self._files.move_to_end(path)
            if len(self._files) > self._most_files:
                self._files.popitem(last=False)
        with verification.lock:
            identity, outcome = identity_of(regular_status(path)), verification.outcome
            if outcome is None or outcome[0] != identity:
                sha256 = compute_digest(path)
                outcome = identity, sha256, self._compare(path, sha256)
                verification.outcome = outcome if time.time_ns() - identity[-1] > _SETTLED_NS else None
        _, sha256, reason = outcome
        if reason is not None:
            raise DamagedResult(path.name, reason)
        return sha256

    def _compare(self, path: Path, sha256: bytes) -> str | None:
        """Return why a file is not the one that the job wrote; None if it is."""
        noted = self._noted(path)
        if noted is not None:
            return None if noted == sha256 else "its digest is not the one that was taken when it was written"
        try:
            self._read_apart(path)
        except DamagedResult as error:
            return error.reason
        self._note(path, sha256)
        return None


def compute_digest(path: Path) -> bytes:
    """Compute the sha256 of a file; no link is followed and no pipe waited for; raise `FileNotFoundError`."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").digest()


def identity_of(status: os.stat_result) -> FileIdentity:
    """Return what changes when another file takes the place of a file, or somebody writes to it."""
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def regular_status(path: Path) -> os.stat_result:
    """Return the status of a result's file.

    Raises
    ------
    DamagedResult
        It is a link, a pipe, a device or a folder.
    FileNotFoundError
        There is no file.
    """
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode):
        raise DamagedResult(path.name, "it is a link, a pipe, a device or a folder")
    return status
