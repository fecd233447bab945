"""Contents of a file of another format than HDF5, from its headers alone."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from sawmill_formats.errors import quoted
from sawmill_formats.input.archives import members, opened
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.image_names import natural_key
from sawmill_formats.input.matlab.mat5_variables import list_variables
from sawmill_formats.input.npy import read_header
from sawmill_formats.input.parts import Part, PartKind
from sawmill_formats.input.tiff.pages import opened_tiff, page_type
from sawmill_formats.input.zipped import is_npz


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
        kind = Path(info.filename).suffix.lower().lstrip(".") or None
        yield Part(
            quoted(info.filename),
            PartKind.FILE,
            type=kind,
            stored_bytes=info.compress_size,
            compression=_packing(info),
        )


def _packing(info: ZipInfo) -> str | None:
    return "deflate" if info.compress_type == ZIP_DEFLATED else None
