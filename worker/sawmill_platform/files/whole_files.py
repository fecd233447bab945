"""Files that are complete on the disk or missing; for every package, with the standard library alone."""

import ctypes
import errno
import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, TypeVar

File = TypeVar("File", bound=BinaryIO)

# No space, or an exhausted quota.
DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
# A disk that has errors or was made read-only because of errors; a share whose server is away or has lost the folder.
DISK_AWAY = frozenset(
    {errno.EROFS, errno.EIO, errno.EUCLEAN, errno.ESTALE, errno.ENOTCONN, errno.EHOSTDOWN, errno.ETIMEDOUT}
)

_LIBC = ctypes.CDLL(None, use_errno=True)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a new file, to write and to read, that gets its name when the block ends well, and is removed otherwise.

    Raises
    ------
    OSError
        The file cannot be written, for example on a full disk; an older file stays unchanged.
    """
    part = path.with_name(f".{path.name}.part"[:255])
    with renamed(part, path), flushed(part.open("w+b")) as file:
        yield file


@contextmanager
def renamed(part: Path, path: Path) -> Iterator[None]:
    """Rename the file that the block writes when the block ends well, and remove it otherwise."""
    try:
        yield
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


@contextmanager
def flushed(file: File) -> Iterator[File]:
    """Close a file at the end of the block; when closing succeeds, the file is on its disk."""
    with file:
        yield file
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def flushed_file_system(folder: Path) -> Iterator[None]:
    """Make all that the block writes to the file system of a folder durable when the block ends well.

    One call for many small files takes a small part of the time that a call for each of them takes.
    """
    descriptor = os.open(folder, os.O_RDONLY)  # opened first: failures are reported from here on
    try:
        yield
        if _LIBC.syncfs(descriptor) != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(folder))
    finally:
        os.close(descriptor)


def flush(path: Path) -> None:
    """Make a file durable, or the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_names(folder: Path) -> None:
    """Make the names in a folder durable, if its file system supports that.

    Some network shares do not support this for folders: their server writes names when it chooses.
    """
    try:
        flush(folder)
    except OSError as error:
        if error.errno not in {errno.EINVAL, errno.ENOTSUP}:
            raise


def open_regular(path: Path | str, within: int | None = None) -> io.BufferedReader:
    """Open a regular file to read, in an open folder if given: no link is followed and no pipe waited for."""

    def without_following(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=within)

    file = open(path, "rb", opener=without_following)  # noqa: SIM115 - the caller's; Path has no opener
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "is no ordinary file", str(path))
    return file
