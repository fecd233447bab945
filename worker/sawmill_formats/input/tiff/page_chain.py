"""The chain of pages of a TIFF, followed and added up before the library uses it.

Layout: Adobe, "TIFF Revision 6.0", section 2; BigTIFF's layout differs in the widths of numbers.
"""

import struct
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan

if TYPE_CHECKING:
    import tifffile

MOST_PAGES = 100_000
# Bytes of one value, by its type's number.
VALUE_BYTES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8], np.float64)


def check_chain(tiff: "tifffile.TiffFile", name: str, size_bytes: int) -> None:
    """Refuse pages that are too many, incomplete or share data: `wrong-shape`, `truncated-file`, `too-large`."""
    layout, stream = tiff.tiff, tiff.filehandle
    width = layout.offsetsize
    tag = np.dtype([("what", "u2"), ("type", "u2"), ("count", f"u{width}"), ("at", f"V{width}")])
    at, pages, claimed = tiff.pages[0].offset, 0, 0.0
    while at:
        pages += 1
        if pages > MOST_PAGES:
            raise UnreadableScan(
                "wrong-shape", f"{name} has more than {MOST_PAGES} pages; a scan has one for each view"
            )
        stream.seek(at)
        # The library stops without an error where the chain leads beyond the end of a truncated file.
        (tags,) = struct.unpack(layout.tagnoformat, _whole(stream, layout.tagnosize, name))
        claimed += tags * tag.itemsize
        _check_claimed(claimed, size_bytes, pages, name)
        stored = np.frombuffer(_whole(stream, tags * tag.itemsize, name), tag.newbyteorder(layout.byteorder))
        claimed += _values_bytes(stored, width)
        _check_claimed(claimed, size_bytes, pages, name)
        (at,) = struct.unpack(layout.offsetformat, _whole(stream, width, name))


def _values_bytes(tags: NDArray[np.void], inside_bytes: int) -> float:
    """Return the number of bytes that tags claim for values stored outside of the tags."""
    types = np.minimum(tags["type"], len(VALUE_BYTES) - 1)
    sizes = VALUE_BYTES[types] * tags["count"]
    return float(sizes[sizes > inside_bytes].sum())


def _whole(stream: "tifffile.FileHandle", length: int, name: str) -> bytes:
    data: bytes = stream.read(length)
    if len(data) < length:
        raise UnreadableScan("truncated-file", f"{name} ends before its last page; export it again")
    return data


def _check_claimed(claimed: float, size_bytes: int, pages: int, name: str) -> None:
    if claimed > size_bytes:
        raise UnreadableScan(
            "too-large",
            f"the tags of pages 0 to {pages - 1} of {name} claim {claimed:.0f} bytes of its {size_bytes}: it is "
            "damaged or they share their values; export it again",
        )
