"""Checks of an array of any format, most before its data are read: sizes, also unpacked ones, and stored numbers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

if TYPE_CHECKING:
    import h5py

import zlib
from collections.abc import Callable

MAX_BYTES = 8 * 2**30

# No measurement packs so well; what a file declares below the second number does no harm.
LARGEST_RATIO = 200
HARMLESS_BYTES = 64 * 2**20

# NumPy's letters of types that are no real numbers.
OTHER_KINDS = {
    "O": "texts or objects",
    "S": "text",
    "U": "text",
    "V": "records",
    "b": "true or false",
    "c": "complex numbers",
    "M": "dates",
    "m": "durations",
}


class LinkedFiles(Protocol):
    """The files that an HDF5 file leads to; `missing` has links to no file that were met while members were listed."""

    missing: list[UnreadableScan]

    def root(self, beside: "h5py.Group | h5py.Dataset", name: str, path: str) -> "h5py.Group":
        """Return the root group of the file that an external link names."""

    def stored_bytes(self, where: str, dataset: "h5py.Dataset", bounds: "Bounds") -> int:
        """Return the bytes stored of a dataset whose data are in other files."""


@dataclass(frozen=True)
class Bounds:
    """Limits of reading: the number of bytes, as float32 or as stored, whichever is more, and the files."""

    array: int  # largest array that is read a block at a time
    piece: int  # largest piece in memory at once: an array that is read as a whole, or what a file stores in one piece
    linked: LinkedFiles | None = None  # files behind the links of an HDF5 file; None: such links are refused

    @property
    def whole(self) -> "Bounds":
        """Bounds of arrays that are read as a whole."""
        return replace(self, array=self.piece)


def check_number_type(what: str, dtype: np.dtype[Any]) -> None:
    """Refuse everything but real numbers: `wrong-type`."""
    if dtype.kind not in "iuf":
        raise UnreadableScan(
            "wrong-type",
            f"{what} is of type {dtype.name} ({OTHER_KINDS.get(dtype.kind, 'no numbers')}); a scan holds integers or "
            "floating-point numbers",
        )


def check_size(what: str, shape: Sequence[int], itemsize: int, *, stored_bytes: int, max_bytes: int) -> None:
    """Refuse an array that is larger than allowed, or far larger than what is stored of it: `too-large`."""
    elements = math.prod(shape)
    needed, declared = elements * max(itemsize, 4), elements * itemsize
    if needed > max_bytes:
        raise UnreadableScan(
            "too-large",
            f"{what} needs {needed} bytes as {'float32' if itemsize <= 4 else 'stored'} and at most {max_bytes} are "
            "allowed or free; upload fewer rows",
        )
    if declared > HARMLESS_BYTES and stored_bytes * LARGEST_RATIO < declared:
        raise UnreadableScan(
            "too-large",
            f"{what} declares {declared} bytes of data while the file stores only {stored_bytes} of them; above "
            f"{HARMLESS_BYTES >> 20} MiB it may be at most {LARGEST_RATIO} times as many",
        )


def check_scan_dimensions(what: str, shape: Sequence[int]) -> None:
    """Refuse projections that are neither (views, detector) nor (views, rows, detector): `wrong-shape`."""
    if len(shape) not in {2, 3} or 0 in shape:
        wrong = f"{len(shape)} axes instead of 2 or 3" if len(shape) not in {2, 3} else "an axis of length 0"
        raise UnreadableScan(
            "wrong-shape",
            f"{what} has the shape {tuple(shape)}; projections are (views, rows, detector) or (views, detector), and "
            f"this has {wrong}",
        )


def as_float32(array: NDArray[Any]) -> NDArray[np.float32]:
    """Convert to contiguous float32; what float32 cannot hold becomes infinite and is refused later, with its place."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, dtype=np.float32)


def as_fields(name: str, fields: NDArray[np.float32], dimensions: int) -> NDArray[np.float32]:
    """Return flat or dark fields as (n, rows, detector), for projections of 2 or 3 dimensions.

    Fields with one dimension less than the projections are a single one.
    """
    if fields.ndim == dimensions - 1:
        fields = fields[np.newaxis]
    if fields.ndim != dimensions:
        raise UnreadableScan(
            "wrong-shape",
            f"the {name} fields have the shape {fields.shape}, {fields.ndim} axes, beside projections of {dimensions}; "
            f"give {'(n, rows, detector) or (rows, detector)' if dimensions == 3 else '(n, detector) or (detector,)'}",
        )
    return fields[:, np.newaxis, :] if dimensions == 2 else fields


def check_fields(name: str, shape: tuple[int, ...], of_view: Sequence[int]) -> None:
    """Refuse fields (n, rows, detector) whose (rows, detector) differ from the views': `wrong-shape`."""
    if not shape[0]:
        raise UnreadableScan(
            "wrong-shape", f"the {name} fields have the shape {shape}: there are 0 of them, at least 1 is needed"
        )
    wrong = [
        f"{mine} {what} where the views have {views}"
        for what, mine, views in zip(("rows", "cells"), shape[1:], of_view, strict=True)
        if mine != views
    ]
    if wrong:
        raise UnreadableScan(
            "wrong-shape",
            f"the {name} fields have the shape {shape} as (n, rows, detector) and the views (rows, detector) = "
            f"{tuple(of_view)}: {' and '.join(wrong)}; both need the same rows and cells",
        )


@dataclass(frozen=True)
class Scaling:
    """The linear function that gives values of stored numbers, and the names under which the file states it."""

    scale: float = 1.0
    offset: float = 0.0
    names: str = ""

    @classmethod
    def of(cls, names: str, scale: float, offset: float, *, inverse: bool = False) -> Self | None:
        """Return this function or its inverse; None where a number cannot be used."""
        if inverse and scale:
            scale, offset = 1.0 / scale, -offset / scale
        return cls(scale, offset, names) if scale and isfinite(scale) and isfinite(offset) else None

    def apply(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Make values of the stored numbers: in place, or in single precision where this is exact, else in double."""
        if (self.scale, self.offset) == (1.0, 0.0):
            return stored
        values = stored.astype(np.result_type(stored.dtype, np.float32), copy=False)
        values *= self.scale
        values += self.offset
        return values

    def remarks(self, path: str | None = None) -> tuple[Reason, ...]:
        """Return the remark that values of a dataset, or of the images, were unpacked, where a name states so."""
        if (self.scale, self.offset) == (1.0, 0.0) or not self.names:
            return ()
        numbers = {"names": self.names, "scale": f"{self.scale:.9g}", "offset": f"{self.offset:.9g}"}
        if path is None:
            return (ReadingMessage.PIXELS_UNPACKED(**numbers),)
        return (ReadingMessage.UNPACKED(path=path, **numbers),)


# Data that cannot be packed grow by less than this in every packing that is read.
MOST_GROWTH = 1.01
PACKING_BYTES = 1024
# Bytes that are inflated at a time where only their number is needed.
STEP_BYTES = 2**14


@dataclass(frozen=True)
class Packing:
    """A way to pack: its name, and the largest ratio of unpacked to stored bytes.

    `unpacked` counts the bytes that packed data unpack to, up to some number beyond the given one.
    """

    name: str
    most: int
    unpacked: Callable[[bytes, int], int]

    def harmless(self, stored_bytes: int) -> bool:
        """Return whether this number of bytes cannot unpack to a harmful size."""
        return stored_bytes * self.most <= HARMLESS_BYTES


def check_packed(what: str, stored_bytes: int, declared_bytes: int) -> None:
    """Refuse data stored in more bytes than packing makes of the declared bytes: `too-large`."""
    if stored_bytes > _most(declared_bytes):
        raise UnreadableScan(
            "too-large", f"{what} declares {declared_bytes} bytes of data while the file stores {stored_bytes} for them"
        )


def check_unpacks(what: str, packing: Packing, packed: bytes, declared_bytes: int) -> None:
    """Refuse packed data that unpack to more than is declared, keeping none of them: `too-large`."""
    most = _most(declared_bytes)
    if packing.unpacked(packed, most) > most:
        raise UnreadableScan(
            "too-large",
            f"{what} declares {declared_bytes} bytes of data and unpacks to more ({packing.name}); export it again",
        )


def _most(declared_bytes: int) -> int:
    return int(MOST_GROWTH * declared_bytes) + PACKING_BYTES


def _deflated(packed: bytes, most: int) -> int:
    inflater, inflated = zlib.decompressobj(), 0
    for start in range(0, len(packed), STEP_BYTES):
        inflated += len(inflater.decompress(packed[start : start + STEP_BYTES]))
        if inflated > most:
            break
    return inflated


def _packbits(packed: bytes, most: int) -> int:
    from sawmill_formats._chunks_numba import packbits_bytes  # noqa: PLC0415 - Numba, for such data only

    return int(packbits_bytes(np.frombuffer(packed, np.uint8), most))


# Deflate: RFC 1951, 258 bytes from two bits. PackBits: 128 bytes from two; the library's decoder stores each byte as an
# object of a list, eight bytes, and then as itself.
DEFLATE = Packing("deflate", 1032, _deflated)
PACKBITS_MEMORY = 9
PACKBITS = Packing("PackBits", 64 * PACKBITS_MEMORY, _packbits)
