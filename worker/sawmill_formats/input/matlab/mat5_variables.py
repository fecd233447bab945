"""The variables of a MATLAB file of version 5, and the fields of structs in them, listed without their data.

Layout: The MathWorks, "MAT-File Format", chapter 1 (level 5). Only arrays of numbers and short texts are built: no
object, function or cell.
"""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.arrays import HARMLESS_BYTES, LARGEST_RATIO
from sawmill_formats.input.matlab.mat5_stream import TAG_BYTES, Element, VariableStream

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
    name = _head(stream).decode("latin-1").rstrip("\0")
    described = replace(
        here,
        kind="logical" if flags >> 8 & LOGICAL else kind,
        shape=shape,
        is_complex=bool(flags >> 8 & COMPLEX),
        position=stream.position,
    )
    return name, described


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
