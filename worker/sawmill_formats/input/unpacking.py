"""Sizes of packed data after unpacking, found before any data are kept."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.arrays import HARMLESS_BYTES

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
    from sawmill_formats.input._unpacked_numba import packbits_bytes  # noqa: PLC0415 - Numba, for such data only

    return int(packbits_bytes(_bytes(packed), most))


def _bytes(packed: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(packed, np.uint8)


# Deflate: RFC 1951, 258 bytes from two bits. PackBits: 128 bytes from two; the library's decoder stores each byte as an
# object of a list, eight bytes, and then as itself.
DEFLATE = Packing("deflate", 1032, _deflated)
PACKBITS_MEMORY = 9
PACKBITS = Packing("PackBits", 64 * PACKBITS_MEMORY, _packbits)
