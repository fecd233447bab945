"""Files that are complete after a power cut, and moves that lose no data."""

import errno
import hashlib
import os
import shutil
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from sawmill_platform.files.whole_files import flush_names, flushed, open_regular, renamed, whole_file
from sawmill_worker.watching.stopping import Stop

_CHUNK_BYTES = 2**20

Signature = tuple[int, int]


class FileChanged(Exception):  # noqa: N818 - caused by the writer
    """A file that was complete has been written to; the message gives the time."""


def signature(path: Path) -> Signature:
    """Return size in bytes and time of the last change in ns; the file is opened so that a network share is queried."""
    with open_regular(path) as file:
        return signature_of(file)


def signature_of(file: BinaryIO) -> Signature:
    """Return size in bytes and time of the last change in ns of an open file."""
    status = os.fstat(file.fileno())
    return status.st_size, status.st_mtime_ns


def sha256_of(path: Path, stop: Stop) -> str:
    """Compute the SHA-256 of a file, in hexadecimal digits.

    Raises
    ------
    Stopped
        The watcher was asked to end during the computation.
    """
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while chunk := file.read(_CHUNK_BYTES):
            stop.check()
            digest.update(chunk)
    return digest.hexdigest()


def make_folder(path: Path) -> None:
    """Make a folder if it does not exist.

    Raises
    ------
    NotADirectoryError
        A link or another file has this name: users who can write there must not redirect the files elsewhere.
    """
    try:
        path.mkdir()
    except FileExistsError:
        if not stat.S_ISDIR(path.lstat().st_mode):
            raise NotADirectoryError(errno.ENOTDIR, "must be a folder and no link", str(path)) from None
    else:
        flush_names(path.parent)


def write_durably(path: Path, text: str) -> None:
    """Write a file completely or not at all."""
    with whole_file(path) as file:
        file.write(text.encode())
    flush_names(path.parent)


def move(source: Path, target: Path) -> None:
    """Rename a file, by a copy to another file system; an interrupted move can be repeated.

    Raises
    ------
    OSError
        The file is still at `source`.
    """
    try:
        source.rename(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        _copy(source, target)
        source.unlink()
    flush_names(target.parent)
    flush_names(source.parent)


def _copy(source: Path, target: Path) -> None:
    part = target.with_name(f".{target.name}.part"[:255])
    with renamed(part, target):
        with open_regular(source) as original, flushed(part.open("wb")) as copy:
            shutil.copyfileobj(original, copy, _CHUNK_BYTES)
        # Shares whose files all belong to another user accept neither times nor permissions.
        with suppress(PermissionError):
            shutil.copystat(source, part)
    flush_names(target.parent)
