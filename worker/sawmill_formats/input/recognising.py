"""Recognition of a file's format by its content, never by its name, and its contents from its headers alone."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from sawmill_formats.errors import UnreadableScan, check_regular, quoted
from sawmill_formats.input.archives import is_npz, members, opened, read_zip
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents, Part, PartKind, Wanted
from sawmill_formats.input.hdf5.any_layout import read_hdf5
from sawmill_formats.input.hdf5.listing import hdf5_parts
from sawmill_formats.input.image_names import natural_key
from sawmill_formats.input.mat5 import list_variables, read_mat5
from sawmill_formats.input.npy import read_header, read_npy
from sawmill_formats.input.tiff.pages import opened_tiff, page_type, read_tiff
from sawmill_formats.input.tiff.several_files import folder_parts, read_folder


def mat5_parts(path: Path, bounds: Bounds) -> Iterator[Part]:
    """Yield the variables, and the fields of structs."""
    for name, variable in list_variables(path, bounds.array).items():
        yield Part(
            quoted(name),
            PartKind.VARIABLE,
            shape=variable.shape,
            type=f"complex {variable.kind}" if variable.is_complex else variable.kind,
            # For a field this is what the file stores of the whole struct.
            stored_bytes=None if "/" in name else variable.stored_bytes,
            compression="deflate" if variable.packed else None,
        )


def npy_parts(path: Path, _: Bounds) -> Iterator[Part]:
    """Yield the one array."""
    with path.open("rb") as stream:
        header = read_header(stream)
        stored = path.stat().st_size - stream.tell()
    yield Part("the array", PartKind.ARRAY, header.shape, header.dtype.name, stored_bytes=stored)


def tiff_parts(path: Path, _: Bounds) -> Iterator[Part]:
    """Yield the pages."""
    with opened_tiff(path, "the file", path.stat().st_size) as tiff:
        for index, page in enumerate(tiff.pages):
            number_type, compression = page_type(page)
            stored = sum(page.databytecounts)
            yield Part(
                f"page {index}", PartKind.PAGE, page.shape, number_type, stored_bytes=stored, compression=compression
            )


def zip_parts(path: Path, bounds: Bounds) -> Iterator[Part]:
    """Yield the arrays of a NPZ file, or the files of another archive, which are not unpacked."""
    with opened(path) as archive:
        infos = members(archive, path.stat().st_size, bounds.array)
        yield from _arrays(archive, infos) if is_npz(infos) else _files(infos)


def _arrays(archive: ZipFile, infos: Sequence[ZipInfo]) -> Iterator[Part]:
    for info in infos:
        with archive.open(info) as stream:
            header = read_header(stream)
        yield Part(
            quoted(info.filename.removesuffix(".npy")),
            PartKind.ARRAY,
            shape=header.shape,
            type=header.dtype.name,
            stored_bytes=info.compress_size,
            compression=_packing(info),
        )


def _files(infos: Sequence[ZipInfo]) -> Iterator[Part]:
    for info in sorted(infos, key=lambda info: natural_key(info.filename)):
        yield Part(
            quoted(info.filename),
            PartKind.FILE,
            type=Path(info.filename).suffix.lower().lstrip(".") or None,
            stored_bytes=info.compress_size,
            compression=_packing(info),
        )


def _packing(info: ZipInfo) -> str | None:
    return "deflate" if info.compress_type == ZIP_DEFLATED else None


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
