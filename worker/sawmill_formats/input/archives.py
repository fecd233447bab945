"""ZIP archives that are safe to unpack, decided from their directory alone."""

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import HARMLESS_BYTES, LARGEST_RATIO

MOST_MEMBERS = 100_000
ENCRYPTED = 0x1
DIRECTORY_ENTRY = b"PK\x01\x02"
LARGEST_DIRECTORY_BYTES = 16 * 2**20


@contextmanager
def opened(path: Path) -> Iterator[ZipFile]:
    """Open an archive whose members were counted before any object was made for them: `too-large`."""
    with _Counted(path) as stream, ZipFile(stream) as archive:
        stream.largest = math.inf
        yield archive


class _Counted(io.FileIO):
    """A file that lets its archive's directory be read only where it has few enough entries.

    The standard library reads the directory in one piece and makes an object for each entry, however many there are.
    """

    largest: float = LARGEST_DIRECTORY_BYTES

    def read(self, size: int | None = -1, /) -> bytes:
        length = -1 if size is None else size
        if length > self.largest:
            raise UnreadableScan(
                "too-large",
                f"the archive's directory has {length} bytes; at most {LARGEST_DIRECTORY_BYTES} and {MOST_MEMBERS} "
                "files are allowed",
            )
        data = super().read(length) or b""
        if self.largest < math.inf and data.count(DIRECTORY_ENTRY) > MOST_MEMBERS:
            raise _too_many(data.count(DIRECTORY_ENTRY))
        return data


def _too_many(count: int) -> UnreadableScan:
    return UnreadableScan("too-large", f"the archive holds {count} files; at most {MOST_MEMBERS} are allowed")


def members(archive: ZipFile, size_bytes: int, max_bytes: int) -> list[ZipInfo]:
    """Return every file in the archive of this size in bytes, all of them checked.

    What is unpacked of a member never exceeds the size checked here: the reader of the standard library stops there.
    """
    infos = [info for info in archive.infolist() if not info.is_dir()]
    if len(infos) > MOST_MEMBERS:
        raise _too_many(len(infos))
    for info in infos:
        _check_member(info)
    declared = sum(info.file_size for info in infos)
    stored = sum(info.compress_size for info in infos)
    if stored > size_bytes:
        raise UnreadableScan(
            "unsafe-archive",
            f"the archive's files claim to be stored in {stored} bytes of its {size_bytes}: they share their data; "
            "pack each on its own",
        )
    if declared > max_bytes:
        raise UnreadableScan(
            "too-large",
            f"the archive unpacks to {declared} bytes and at most {max_bytes} are allowed or free; upload fewer rows",
        )
    if declared > HARMLESS_BYTES and stored * LARGEST_RATIO < declared:
        raise UnreadableScan(
            "too-large",
            f"the archive declares {declared} bytes and stores {stored}; no scan packs so well: above "
            f"{HARMLESS_BYTES >> 20} MiB it may be at most {LARGEST_RATIO} times as many",
        )
    return infos


def _check_member(info: ZipInfo) -> None:
    name = repr(quoted(info.filename))
    path = PurePosixPath(info.filename.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or ":" in info.filename:
        raise UnreadableScan(
            "unsafe-archive", f"the archive holds {name}, which points outside of it; pack plain names"
        )
    if info.flag_bits & ENCRYPTED:
        raise UnreadableScan("unsafe-archive", f"{name} is encrypted; pack the archive without a password")
    if info.compress_type not in {ZIP_STORED, ZIP_DEFLATED}:
        raise UnreadableScan("unsafe-archive", f"{name} is packed by method {info.compress_type}; use deflate or store")
