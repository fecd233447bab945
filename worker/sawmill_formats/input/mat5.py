"""The variables of a MATLAB file of version 5, and the fields of structs in them, listed without their data.

Layout: The MathWorks, "MAT-File Format", chapter 1 (level 5). Only arrays of numbers and short texts are built: no
object, function or cell.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import (
    HARMLESS_BYTES,
    LARGEST_RATIO,
    Bounds,
    as_float32,
    check_number_type,
    check_size,
)
from sawmill_formats.input.contents import FileContents, Wanted, held
from sawmill_formats.input.named_arrays import LONGEST_TEXT, ArrayInfo, NamedArrays, read_named_arrays

TAG_BYTES = 8
SMALL_DATA_BYTES = 4
PIECE_BYTES = 2**20


@dataclass(frozen=True)
class Element:
    """A tag of an element: the stored type, the number of bytes, and their number with padding."""

    type: int
    data_bytes: int
    padded_bytes: int


class VariableStream:
    """A variable, unpacked if it is packed, read forwards; never more in memory than the file stores."""

    def __init__(self, file: BinaryIO, stored_bytes: int, *, packed: bool, order: str, most_bytes: int) -> None:
        self.order = order
        self.position = 0
        declared = max(HARMLESS_BYTES, LARGEST_RATIO * stored_bytes)
        self._file, self._left, self._most = file, stored_bytes, min(most_bytes, declared) if packed else most_bytes
        self._inflater = zlib.decompressobj() if packed else None

    def element(self) -> Element:
        """Read the next tag; a small element contains its data, which come next."""
        word, *_ = struct.unpack(f"{self.order}I", self.read(4))
        if word >> 16:
            return Element(word & 0xFFFF, word >> 16, SMALL_DATA_BYTES)
        length, *_ = struct.unpack(f"{self.order}I", self.read(4))
        return Element(word, length, -(-length // TAG_BYTES) * TAG_BYTES)

    def data(self, element: Element) -> bytearray:
        """Read the data of the element whose tag was read last, and skip the padding."""
        if element.data_bytes > element.padded_bytes:
            raise ValueError(f"an element of {SMALL_DATA_BYTES} bytes claims {element.data_bytes}")
        end = self.position + element.padded_bytes
        data = self.read(element.data_bytes)
        self.skip_to(end)
        return data

    def read(self, length: int) -> bytearray:
        """Read this number of bytes; EOFError where there are fewer."""
        data = bytearray()
        while len(data) < length:
            data += self._piece(min(length - len(data), PIECE_BYTES))
        return data

    def skip_to(self, position: int) -> None:
        """Read on to a later position without keeping anything."""
        if position < self.position:
            raise ValueError("a part of a variable is longer than the whole")
        while self.position < position:
            self._piece(min(position - self.position, PIECE_BYTES))

    def check_end(self) -> None:
        """Unpack the rest of a packed variable, whose checksum is at its end."""
        while self._inflater is not None and not self._inflater.eof:
            self._piece(PIECE_BYTES, required=False)

    def _piece(self, most: int, *, required: bool = True) -> bytes:
        piece = self._stored(most) if self._inflater is None else self._unpacked(self._inflater, most)
        if not piece and (required or not (self._inflater is not None and self._inflater.eof)):
            raise EOFError("a variable ends before its data do")
        self.position += len(piece)
        if self.position > self._most:
            raise UnreadableScan(
                "too-large",
                f"a variable unpacks to more than the {self._most} bytes that are allowed or free, or 200 times "
                "what is stored of it",
            )
        return piece

    def _unpacked(self, inflater: "zlib._Decompress", most: int) -> bytes:
        while not inflater.eof:
            stored = inflater.unconsumed_tail or self._stored(PIECE_BYTES)
            piece = inflater.decompress(stored, most)
            if piece or not stored:
                return piece
        return b""

    def _stored(self, most: int) -> bytes:
        piece = self._file.read(min(most, self._left))
        self._left -= len(piece)
        return piece


HEADER_BYTES = 128
MATRIX, COMPRESSED = 14, 15
LOGICAL, COMPLEX = 0x02, 0x08
MATLAB_CLASSES = {
    1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 6: "double", 7: "single", 8: "int8", 9: "uint8",
    10: "int16", 11: "uint16", 12: "int32", 13: "uint32", 14: "int64", 15: "uint64", 16: "function", 17: "opaque",
}  # fmt: skip
STORED_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
STORED_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
MOST_BYTES_A_VALUE = 8
MOST_VARIABLES = 10_000
DEEPEST_STRUCT = 8
LONGEST_HEAD_BYTES = 2**20


@dataclass(frozen=True)
class Variable:
    """A variable or a field, and where the data are."""

    kind: str  # MATLAB's class
    shape: tuple[int, ...]
    is_complex: bool
    offset: int
    stored_bytes: int
    packed: bool
    position: int = 0  # position of the data in the unpacked variable


def list_variables(path: Path, most_bytes: int) -> dict[str, Variable]:
    """Return every variable by its name, and every field of a struct by its path with slashes."""
    listed = list(islice(_variables(path, most_bytes), MOST_VARIABLES + 1))
    if len(listed) > MOST_VARIABLES:
        raise UnreadableScan("too-large", f"the file holds more than {MOST_VARIABLES} variables and fields")
    return dict(listed)


def read_numbers(path: Path, variable: Variable, most_bytes: int) -> NDArray[Any]:
    """Read the numbers of a variable of real numbers, in its shape and type."""
    element, data, order = _read_data(path, variable, most_bytes)
    if element.type not in STORED_NUMBERS:
        raise ValueError(f"numbers are stored as type {element.type}")
    stored = np.frombuffer(data, order + STORED_NUMBERS[element.type])
    if stored.size != math.prod(variable.shape):
        raise ValueError(f"{variable.shape} values are declared and {stored.size} stored")
    return stored.astype(variable.kind, copy=False).reshape(variable.shape, order="F")


def read_text(path: Path, variable: Variable, most_bytes: int) -> str:
    """Read the text of a variable of characters; exceptions as in `read_numbers`."""
    element, data, order = _read_data(path, variable, most_bytes)
    encoding = STORED_TEXTS.get(element.type, "latin-1")
    ending = {"<": "-le", ">": "-be"}[order] if encoding[-2:] in {"16", "32"} else ""
    return data.decode(encoding + ending, "replace")


def _read_data(path: Path, variable: Variable, most_bytes: int) -> tuple[Element, bytearray, str]:
    with path.open("rb") as file:
        order = _byte_order(file.read(HEADER_BYTES))
        file.seek(variable.offset)
        stream = VariableStream(file, variable.stored_bytes, packed=variable.packed, order=order, most_bytes=most_bytes)
        stream.skip_to(variable.position)
        element = stream.element()
        if element.data_bytes > MOST_BYTES_A_VALUE * math.prod(variable.shape):
            raise ValueError(f"{variable.shape} values are declared and {element.data_bytes} bytes stored")
        data = stream.data(element)
        stream.check_end()
    return element, data, order


def _byte_order(header: bytes) -> str:
    return "<" if header[-2:] == b"IM" else ">"


def _variables(path: Path, most_bytes: int) -> Iterator[tuple[str, Variable]]:
    size = path.stat().st_size
    if size == HEADER_BYTES:
        raise EOFError("no variable follows the header")
    with path.open("rb") as file:
        order, offset, unpacked = _byte_order(file.read(HEADER_BYTES)), HEADER_BYTES, 0
        while offset < size:
            file.seek(offset)
            kind, length = struct.unpack(f"{order}2I", file.read(TAG_BYTES))
            packed = kind == COMPRESSED
            if (not packed and kind != MATRIX) or offset + TAG_BYTES + length > size:
                raise ValueError(f"a variable of type {kind} claims {length} bytes")
            start, stored = (offset + TAG_BYTES, length) if packed else (offset, TAG_BYTES + length)
            file.seek(start)
            stream = VariableStream(file, stored, packed=packed, order=order, most_bytes=most_bytes)
            here = Variable("double", (), is_complex=False, offset=start, stored_bytes=stored, packed=packed)
            yield from _matrix(stream, here, "", 0)
            unpacked += stream.position
            if unpacked > max(HARMLESS_BYTES, LARGEST_RATIO * size):
                raise UnreadableScan(
                    "too-large",
                    f"the structs of the file unpack to more than {LARGEST_RATIO} times its {size} bytes; no scan "
                    "packs so well",
                )
            offset += TAG_BYTES + length


def _matrix(stream: VariableStream, here: Variable, path: str, depth: int) -> Iterator[tuple[str, Variable]]:
    """Yield the matrix with the next tag, and its fields; the stream ends behind a field, not behind a variable."""
    element = stream.element()
    if element.type != MATRIX:
        raise ValueError(f"a variable holds an element of type {element.type} where a matrix must be")
    end = stream.position + element.padded_bytes
    name, described = _described(stream, here) if element.data_bytes else ("", replace(here, shape=(0, 0)))
    path = path or name
    if not path:  # MATLAB's internal variables have no name
        return
    yield path, described
    if described.kind == "struct" and math.prod(described.shape) == 1 and depth < DEEPEST_STRUCT:
        for field in _field_names(stream):
            yield from _matrix(stream, here, f"{path}/{field}", depth + 1)
    if depth:
        stream.skip_to(end)


def _described(stream: VariableStream, here: Variable) -> tuple[str, Variable]:
    """Read the head of the next matrix, and return it by its name (a field has none)."""
    flags, *_ = struct.unpack(f"{stream.order}I", _head(stream)[:4])
    kind = MATLAB_CLASSES.get(flags & 0xFF, f"class {flags & 0xFF}")
    # Opaque objects have no shape.
    shape = () if kind == "opaque" else tuple(n for (n,) in struct.iter_unpack(f"{stream.order}i", _head(stream)))
    if min(shape, default=0) < 0:
        raise ValueError(f"the shape {shape} is declared")
    return _head(stream).decode("latin-1").rstrip("\0"), replace(
        here,
        kind="logical" if flags >> 8 & LOGICAL else kind,
        shape=shape,
        is_complex=bool(flags >> 8 & COMPLEX),
        position=stream.position,
    )


def _field_names(stream: VariableStream) -> list[str]:
    length, *_ = struct.unpack(f"{stream.order}i", _head(stream))
    names = _head(stream)
    if length <= 0:
        raise ValueError(f"the names of fields are {length} bytes long")
    each = (names[start : start + length] for start in range(0, len(names), length))
    return [name.partition(b"\0")[0].decode("latin-1") for name in each]


def _head(stream: VariableStream) -> bytearray:
    element = stream.element()
    if element.data_bytes > LONGEST_HEAD_BYTES:
        raise ValueError(f"a name or shape of {element.data_bytes} bytes")
    return stream.data(element)


MATLAB_NUMBERS = frozenset(
    {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
)


def read_mat5(path: Path, selection: Wanted, bounds: Bounds, _: ExitStack) -> FileContents:
    """Read the variables and fields of structs that are needed, and no others."""
    variables = list_variables(path, bounds.array)
    load = partial(_load, path, variables, bounds)
    arrays = NamedArrays(
        format="mat-v5",
        infos={
            name: ArrayInfo(variable.shape, variable.kind in MATLAB_NUMBERS, variable.kind)
            for name, variable in variables.items()
        },
        load=load,
        projections=lambda name: held(as_float32(load(name))),
        text=partial(_text, path, variables, bounds),
    )
    return read_named_arrays(arrays, selection)


def _load(path: Path, variables: dict[str, Variable], bounds: Bounds, name: str) -> NDArray[Any]:
    variable, where = variables[name], repr(quoted(name))
    check_matlab_class(where, variable.kind)
    check_number_type(where, np.dtype(np.complex128 if variable.is_complex else variable.kind))
    itemsize = np.dtype(variable.kind).itemsize
    check_size(where, variable.shape, itemsize, stored_bytes=variable.stored_bytes, max_bytes=bounds.piece)
    return read_numbers(path, variable, bounds.array)


def check_matlab_class(where: str, kind: str | None) -> None:
    """Refuse variables of MATLAB's classes that are no real numbers: `wrong-type`."""
    if kind is None or kind in MATLAB_NUMBERS:
        return
    fields = ", or name a field of it by its path" if kind == "struct" else ""
    noun = "cell array" if kind == "cell" else quoted(kind)
    raise UnreadableScan("wrong-type", f"{where} is a MATLAB {noun}; a scan is one array of real numbers{fields}")


def _text(path: Path, variables: dict[str, Variable], bounds: Bounds, name: str) -> str | None:
    variable = variables[name]
    if variable.kind != "char" or np.prod(variable.shape, dtype=float) > LONGEST_TEXT:
        return None
    return read_text(path, variable, bounds.array)
