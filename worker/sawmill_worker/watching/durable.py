"""Files that are whole after a power cut, and moves that lose nothing."""

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


class FileChanged(Exception):  # noqa: N818 - its writer's doing
    """Somebody wrote to a file that was whole; the message says when."""


def signature(path: Path) -> Signature:
    """Size in bytes and time of the last change in ns, of the file as it is: opening it asks a network share anew."""
    with open_regular(path) as file:
        return signature_of(file)


def signature_of(file: BinaryIO) -> Signature:
    """The same of an open file."""
    status = os.fstat(file.fileno())
    return status.st_size, status.st_mtime_ns


def sha256_of(path: Path, stop: Stop) -> str:
    """Of a file's bytes, in hexadecimal digits.

    Raises
    ------
    Stopped
        Meanwhile.
    """
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while chunk := file.read(_CHUNK_BYTES):
            stop.check()
            digest.update(chunk)
    return digest.hexdigest()


def make_folder(path: Path) -> None:
    """Make a folder where there is none.

    Raises
    ------
    NotADirectoryError
        A link or something else stands there: whoever can write there must not lead the files elsewhere.
    """
    try:
        path.mkdir()
    except FileExistsError:
        if not stat.S_ISDIR(path.lstat().st_mode):
            raise NotADirectoryError(errno.ENOTDIR, "must be a folder and no link", str(path)) from None
    else:
        flush_names(path.parent)


def write_durably(path: Path, text: str) -> None:
    """Write a file that is there whole, or not at all."""
    with whole_file(path) as file:
        file.write(text.encode())
    flush_names(path.parent)


def move(source: Path, target: Path) -> None:
    """Give a file another name, on another file system by a copy; a move that broke off is made again.

    Raises
    ------
    OSError
        The file is where it was.
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
        # Shares whose files all belong to another user take neither times nor rights.
        with suppress(PermissionError):
            shutil.copystat(source, part)
    flush_names(target.parent)
