"""ZIP archives that are safe to unpack, decided from their directory alone, and the TIFF files in them."""

import io
import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path, PurePosixPath
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import HARMLESS_BYTES, LARGEST_RATIO, Bounds
from sawmill_formats.input.contents import FileContents, Wanted
from sawmill_formats.input.npy import read_npz
from sawmill_formats.input.tiff.pages import TiffPages, open_pages
from sawmill_formats.input.tiff.several_files import TiffFile, is_tiff, read_files

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
    """A file whose archive's directory may be read only where it is short: the library makes objects of entries."""

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
            raise UnreadableScan(
                "too-large",
                f"the archive holds {data.count(DIRECTORY_ENTRY)} files; at most {MOST_MEMBERS} are allowed",
            )
        return data


def members(archive: ZipFile, size_bytes: int, max_bytes: int) -> list[ZipInfo]:
    """Return every file in the archive of this size in bytes, all of them checked.

    What is unpacked of a member never exceeds the size checked here: the reader of the standard library stops there.
    """
    infos = [info for info in archive.infolist() if not info.is_dir()]
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


def read_zip(path: Path, selection: Wanted, bounds: Bounds, files: ExitStack) -> FileContents:
    """Read a NPZ file or a ZIP of TIFF files, as the members' names show; a ZIP of TIFFs stays open for its views."""
    archive, size = files.enter_context(opened(path)), path.stat().st_size
    infos = members(archive, size, bounds.array)
    if is_npz(infos):
        return read_npz(archive, members(archive, size, bounds.piece), selection, bounds.piece)
    if selection.dataset is not None:
        raise UnreadableScan(
            "contradiction", f"a ZIP of TIFFs has no named arrays; leave out dataset {quoted(selection.dataset)!r}"
        )
    if not infos:
        raise UnreadableScan("unknown-format", "the archive holds no files; pack the views as .tif files")
    images = [
        TiffFile(info.filename, info.compress_size, partial(_unpacked, archive, info))
        for info in infos
        if is_tiff(info.filename)
    ]
    others = [info.filename for info in infos if not is_tiff(info.filename)]
    return read_files("zip-of-tiffs", images, others, archive.open, selection, bounds, rows_missing=True)


def is_npz(infos: list[ZipInfo]) -> bool:
    """Return whether an archive holds arrays and nothing else."""
    return bool(infos) and all(info.filename.endswith(".npy") for info in infos)


def _unpacked(archive: ZipFile, info: ZipInfo, bounds: Bounds) -> AbstractContextManager[TiffPages]:
    if info.file_size > bounds.piece:
        raise UnreadableScan(
            "too-large",
            f"{quoted(info.filename)!r} unpacks to {info.file_size} bytes and at most {bounds.piece} are allowed "
            "or free; pack fewer views into one file",
        )
    data = archive.read(info)
    return open_pages(BytesIO(data), repr(quoted(info.filename)), len(data), bounds)
