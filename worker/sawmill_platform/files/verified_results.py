"""Verification of results: the content of a file is compared with the digest in its job's row before it is parsed.

A library in C may loop or crash on one changed byte, and would stop the whole process with it. The comparison is made
at the first use of a file in each process, and again when the file is another one or was written to.
"""

import hashlib
import os
import stat
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeAlias

import structlog

from sawmill_platform.errors import DamagedResult, StorageFull, StorageUnavailable
from sawmill_platform.files.whole_files import open_regular

# A file system's clock ticks every 4 ms or so: two changes within a tick leave the same times.
_SETTLED_NS = 100_000_000

# Device, inode, size, and times of the last change of content and of status, which no writer can keep.
FileIdentity: TypeAlias = tuple[int, int, int, int, int]


class Digest(NamedTuple):
    """The sha256 of a file's content, and the identity that the file had then."""

    sha256: bytes
    identity: FileIdentity


class _Verification:
    """The newest verification of one file: its digest, and why the file is not the one that its job wrote."""

    def __init__(self) -> None:
        self.lock = threading.Lock()  # one thread reads the file, and the rest wait for it
        self.outcome: tuple[Digest, str | None] | None = None


class VerifiedResults:
    """Verification of the results of jobs; threads may share it.

    Parameters
    ----------
    noted
        Function from a result's path to the digest in the row of its job; None: the row has none.
    read_apart
        Function that reads a result of an earlier version, which has no digest, in a process of its own; raises
        `DamagedResult`.
    note
        Function that writes the digest of such a result to the row of its job.
    most_files
        Files whose verification is kept in mind; each takes some 500 bytes.
    """

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
        """Return the digest of a result, verified; the first call in a process takes as long as reading the file.

        Raises
        ------
        DamagedResult
            The file is not the one that its job wrote.
        FileNotFoundError
            There is no file.
        """
        identity = identity_of(regular_status(path))
        with self._lock:
            verification = self._files.setdefault(path, _Verification())
            self._files.move_to_end(path)
            if len(self._files) > self._most_files:
                self._files.popitem(last=False)
        with verification.lock:
            outcome = verification.outcome
            if outcome is None or outcome[0].identity != identity:
                computed = compute_digest(path)
                outcome = computed, self._compare(path, computed.sha256)
                settled = time.time_ns() - computed.identity[-1] > _SETTLED_NS
                verification.outcome = outcome if settled else None
        digest, reason = outcome
        if reason is not None:
            raise DamagedResult(path.name, reason)
        return digest.sha256

    def _compare(self, path: Path, sha256: bytes) -> str | None:
        """Return why a file is not the one that its job wrote; None if it is."""
        noted = self._noted(path)
        if noted is None:
            try:
                self._read_apart(path)
            except DamagedResult as error:
                return error.reason
            try:
                self._note(path, sha256)
            except (StorageFull, StorageUnavailable) as error:  # the file can be read all the same
                structlog.get_logger().warning("digest-not-noted", file=path.name, reason=str(error))
        elif noted != sha256:
            return "its digest is not the one that was taken when it was written"
        return None


def compute_digest(path: Path) -> Digest:
    """Compute the digest of a file; no link is followed and no pipe waited for.

    Raises
    ------
    FileNotFoundError
        The file is gone.
    """
    with open_regular(path) as file:
        identity = identity_of(os.fstat(file.fileno()))
        return Digest(hashlib.file_digest(file, "sha256").digest(), identity)


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
