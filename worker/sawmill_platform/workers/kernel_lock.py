"""A lock on a file that the kernel frees however its holder ends; the file contains the holder's process id."""

import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

# `struct flock` of fcntl(2) on 64-bit systems: type, whence, start, length, process.
_FLOCK = "hhqqi4x"
_WHOLE_FILE = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)


class HeldByAnother(Exception):  # noqa: N818 - no error of this process
    """Another process holds the lock; the message is its id, or `unknown`."""


@contextmanager
def kernel_lock(path: Path) -> Iterator[TextIO]:
    """Hold the lock on a file for the block; the file is made if it is missing, and stays.

    Raises
    ------
    HeldByAnother
        Another process holds the lock; the call does not wait.
    OSError
        The file cannot be written, or its file system has no locks.
    """
    # Not emptied before the lock is held: the file contains the holder's id.
    with path.open("a+") as lock:
        try:
            fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _WHOLE_FILE)
        except BlockingIOError as error:
            raise HeldByAnother(_holder(lock)) from error
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
        yield lock


def holder_of(path: Path) -> str | None:
    """Return the id of the process that holds a lock, without taking the lock; None: no process holds it."""
    try:
        with path.open() as lock:
            kind, *_ = struct.unpack(_FLOCK, fcntl.fcntl(lock, fcntl.F_OFD_GETLK, _WHOLE_FILE))
            return None if kind == fcntl.F_UNLCK else _holder(lock)
    except FileNotFoundError:
        return None


def _holder(lock: TextIO) -> str:
    lock.seek(0)
    # Empty for a moment, between the lock and the writing.
    return lock.read().strip() or "unknown"
