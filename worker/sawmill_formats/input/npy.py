"""NumPy's own files, never with pickled objects, their headers compared with the data that are there."""

import io
import math
import struct
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Literal
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, as_float32, check_number_type, check_scan_dimensions, check_size
from sawmill_formats.input.contents import FileContents, Projections, Wanted, held
from sawmill_formats.input.named_arrays import ArrayInfo, NamedArrays, read_named_arrays

# Format of a header's own length, for the versions that hold plain arrays.
LENGTHS = {(1, 0): "<H", (2, 0): "<I"}
# A plain array's header has some hundred bytes; the parser may exhaust its stack on longer ones.
LONGEST_HEADER_BYTES = 4096
LONGEST_AXIS = 2**48
# Bytes of a file that are mapped at a time.
PIECE_BYTES = 16 * 2**20


@dataclass(frozen=True)
class NpyHeader:
    """Contents of a NPY header."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype[Any]

    @property
    def data_bytes(self) -> int:
        """Number of bytes of data that must follow."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy(path: Path, selection: Wanted, bounds: Bounds, _: ExitStack) -> FileContents:
    """Read a NPY file."""
    if selection.dataset is not None:
        raise UnreadableScan(
            "contradiction", f"a NPY file has one array without a name; leave out dataset {quoted(selection.dataset)!r}"
        )
    with path.open("rb") as stream:
        header = read_header(stream)
        offset = stream.tell()
    _check_header("the array", header, path.stat().st_size - offset, bounds.array)
    check_scan_dimensions("the array", header.shape)
    return FileContents(format="npy", projections=_projections(path, header, offset))


def _projections(path: Path, header: NpyHeader, offset: int) -> Projections:
    order: Literal["F", "C"] = "F" if header.fortran_order else "C"
    views, *rows, cells = header.shape
    shape, slowest = (views, rows[0] if rows else 1, cells), 2 if header.fortran_order else 0

    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        parts = [views, rows, slice(0, cells)]
        block = np.empty([part.stop - part.start for part in parts], dtype=np.float32)
        first, length = parts[slowest].start, block.shape[slowest]
        step = max(1, PIECE_BYTES * length // max(1, block.size * header.dtype.itemsize))
        for start in range(0, length, step):
            at = slice(start, min(start + step, length))
            parts[slowest] = slice(first + at.start, first + at.stop)
            # Mapped again for each piece: what was read stays in the process's memory as long as the mapping does.
            stored = np.memmap(path, header.dtype, "r", offset, shape, order)
            with np.errstate(over="ignore"):
                block[(slice(None),) * slowest + (at,)] = stored[tuple(parts)]
        return block

    return Projections(header.shape, read, (views, 1) if header.fortran_order else (1, 1))


def read_npz(archive: ZipFile, infos: list[ZipInfo], selection: Wanted, max_bytes: int) -> FileContents:
    """Read an archive of NPY files, checked by `members`; only the arrays that are needed are unpacked."""
    headers: dict[str, NpyHeader] = {}
    for info in infos:
        with archive.open(info) as stream:
            headers[info.filename.removesuffix(".npy")] = read_header(stream)
    load = partial(_load, archive, headers, max_bytes)
    arrays = NamedArrays(
        format="npz",
        infos={
            name: ArrayInfo(header.shape, header.dtype.kind in "iuf", header.dtype.name)
            for name, header in headers.items()
        },
        load=load,
        projections=lambda name: held(as_float32(load(name))),
    )
    return read_named_arrays(arrays, selection)


def read_header(stream: BinaryIO | Any) -> NpyHeader:  # noqa: ANN401 - a member of an archive is no BinaryIO
    """Read magic and header, leaving the stream at the first byte of data."""
    version = npy_format.read_magic(stream)
    if version not in LENGTHS:
        raise UnreadableScan("wrong-type", f"NPY version {version} is for records; store a plain array of numbers")
    prefix = stream.read(struct.calcsize(LENGTHS[version]))
    (length,) = struct.unpack(LENGTHS[version], prefix)
    if length > LONGEST_HEADER_BYTES:
        raise UnreadableScan(
            "too-large",
            f"the array's header claims to have {length} bytes; at most {LONGEST_HEADER_BYTES} are read: store a plain "
            "array of numbers",
        )
    read = npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
    shape, fortran_order, dtype = read(io.BytesIO(prefix + stream.read(length)))
    if any(n > LONGEST_AXIS for n in shape):
        raise UnreadableScan("too-large", f"the array declares an axis longer than {LONGEST_AXIS}; export it again")
    if any(n < 0 for n in shape):
        raise UnreadableScan("wrong-shape", f"the array declares the shape {shape}; no length can be negative")
    return NpyHeader(tuple(int(n) for n in shape), bool(fortran_order), dtype)


def _load(archive: ZipFile, headers: dict[str, NpyHeader], max_bytes: int, name: str) -> NDArray[Any]:
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as stream:
        header = read_header(stream)
        _check_header(repr(quoted(name)), header, info.file_size - stream.tell(), max_bytes)
        data = stream.read(header.data_bytes)
    values = np.frombuffer(data, dtype=header.dtype)
    return values.reshape(headers[name].shape, order="F" if header.fortran_order else "C")


def _check_header(where: str, header: NpyHeader, present_bytes: int, max_bytes: int) -> None:
    check_number_type(where, header.dtype)
    if header.data_bytes > present_bytes:
        raise UnreadableScan(
            "truncated-file",
            f"{where} declares {header.data_bytes} bytes of data and the file holds {max(present_bytes, 0)}; "
            "export it again",
        )
    check_size(where, header.shape, header.dtype.itemsize, stored_bytes=present_bytes, max_bytes=max_bytes)
