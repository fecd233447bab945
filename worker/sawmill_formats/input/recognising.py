"""Recognition of a file's format by its content, never by its name."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from sawmill_formats.errors import UnreadableScan, check_regular
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.hdf5.any_layout import read_hdf5
from sawmill_formats.input.hdf5.listing import hdf5_parts
from sawmill_formats.input.listing import mat5_parts, npy_parts, tiff_parts, zip_parts
from sawmill_formats.input.matlab.mat5 import read_mat5
from sawmill_formats.input.npy import read_npy
from sawmill_formats.input.parts import Part
from sawmill_formats.input.tiff.folder import folder_parts, read_folder
from sawmill_formats.input.tiff.pages import read_tiff
from sawmill_formats.input.wanted import Wanted
from sawmill_formats.input.zipped import read_zip

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
BYTES_SHOWN = 8
HDF5_OFFSETS = (0, 512, 1024, 2048)  # a user block of such a size may precede it, as in MATLAB files


@dataclass(frozen=True)
class Format:
    """A format: its name, its reader, which keeps the file open in the stack, and its listing.

    Both refuse what is no scan, is damaged or must not be read (`UnreadableScan`).
    """

    name: str
    read: Callable[[Path, Wanted, Bounds, ExitStack], FileContents]
    parts: Callable[[Path, Bounds], Iterator[Part]]


HDF5 = Format("HDF5", read_hdf5, hdf5_parts)
MAT = Format("MAT", read_mat5, mat5_parts)
ZIP = Format("ZIP", read_zip, zip_parts)
NPY = Format("NPY", read_npy, npy_parts)
TIFF = Format("TIFF", read_tiff, tiff_parts)
FOLDER = Format("folder of TIFFs", read_folder, folder_parts)
MAT_VERSIONS = (b"\x00\x01IM", b"\x01\x00MI")  # at byte 124, after a text of the writer's choice
_BY_FIRST_BYTES = (
    (b"\x93NUMPY", NPY),
    (b"PK\x03\x04", ZIP),
    (b"PK\x05\x06", ZIP),
    (b"II*\0", TIFF),
    (b"MM\0*", TIFF),
    (b"II+\0", TIFF),
    (b"MM\0+", TIFF),
)

_PICTURES = ((b"\x89PNG\r\n\x1a\n", "PNG"), (b"\xff\xd8\xff", "JPEG"), (b"GIF8", "GIF"))


def recognise(path: Path) -> Format:
    """Recognise the format of a file or a folder: `empty-file`, `picture-file` or `unknown-format`."""
    if path.is_dir():
        return FOLDER
    check_regular(path)
    with path.open("rb") as stream:
        head = stream.read(HDF5_OFFSETS[-1] + len(HDF5_SIGNATURE))
    if not head:
        raise UnreadableScan("empty-file", "the file is empty; upload it again")
    if any(head[offset:].startswith(HDF5_SIGNATURE) for offset in HDF5_OFFSETS):
        return HDF5
    if head[124:128] in MAT_VERSIONS:
        return MAT
    for first_bytes, file_format in _BY_FIRST_BYTES:
        if head.startswith(first_bytes):
            return file_format
    for first_bytes, name in _PICTURES:
        if head.startswith(first_bytes):
            raise UnreadableScan("picture-file", f"the file is a {name} picture and no scan; give the scanner's file")
    raise UnreadableScan(
        "unknown-format",
        f"the file, which begins with {head[:BYTES_SHOWN]!r}, is none of HDF5 (NXtomo, Data Exchange), TIFF, ZIP of "
        "TIFFs, NPY, NPZ or MAT; export it as one of them",
    )
