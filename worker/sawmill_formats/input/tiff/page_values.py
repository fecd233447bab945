"""Meaning of the numbers of a TIFF's page: tags and descriptions that change the values or flip the image.

Layout: Adobe, "TIFF Revision 6.0", section 8. ImageJ's description and GDAL's metadata (tag 42112) state a linear
function of the stored numbers.
"""

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import as_float32
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

if TYPE_CHECKING:
    import tifffile

BITS_PER_SAMPLE, PHOTOMETRIC, ORIENTATION, GDAL_METADATA = 258, 262, 274, 42112
MIN_IS_WHITE, STRAIGHT_LINE = 0, "0"
COLOURS = {3: "a palette", 32803: "a colour filter"}
# Orientations that begin at the right, and at the bottom; above 4 rows are stored as columns.
FROM_RIGHT, FROM_BOTTOM, LARGEST_ORIENTATION = {2, 3}, {3, 4}, 4
LONGEST_DESCRIPTION = 4096


@dataclass(frozen=True)
class PageValues:
    """Steps from the stored numbers of a page to the image that it means: value = scale x stored + offset.

    Attributes
    ----------
    scale, offset : float
    orientation : int
        Place of the first stored number, 1 to 4, as the tag Orientation states it.
    remarks : tuple of Reason
        Steps that change the image.
    """

    scale: float = 1.0
    offset: float = 0.0
    orientation: int = 1
    remarks: tuple[Reason, ...] = ()

    def image(self, stored: NDArray[Any]) -> NDArray[np.float32]:
        """Return the image or stack (..., rows, detector) float32 that the stored numbers mean."""
        if (self.scale, self.offset) != (1.0, 0.0):
            # In single precision where this is exact for the stored numbers, and in place: a page may be large.
            stored = stored.astype(np.result_type(stored.dtype, np.float32))
            stored *= self.scale
            stored += self.offset
        along_rows, along_cells = (-1 if self.orientation in of else 1 for of in (FROM_BOTTOM, FROM_RIGHT))
        return as_float32(stored)[..., ::along_rows, ::along_cells]


def page_values(page: "tifffile.TiffPage | tifffile.TiffFrame", where: str) -> PageValues:
    """Read what the tags of a page, and the description of the file's first page, state of the numbers.

    Raises
    ------
    UnreadableScan
        `wrong-type` for colours; `unsupported-storage` for a function that is not linear, and rows stored as columns.
    """
    first, number_type = page.parent.pages.first, np.dtype(page.dtype)
    tags: tifffile.TiffTags = getattr(page, "tags", first.tags)
    photometric, orientation = tags.valueof(PHOTOMETRIC, 1), max(1, tags.valueof(ORIENTATION, 1))
    if photometric in COLOURS:
        raise UnreadableScan(
            "wrong-type",
            f"{where} has {COLOURS[photometric]} (PhotometricInterpretation {photometric}); export grey values",
        )
    if orientation > LARGEST_ORIENTATION:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where} has the Orientation {orientation}: its rows are stored as columns; export it with Orientation 1",
        )
    remarks: list[Reason] = []
    factor, added = 1.0, 0.0
    if photometric == MIN_IS_WHITE and number_type.kind == "u":
        factor, added = -1.0, 2.0 ** int(tags.valueof(BITS_PER_SAMPLE)) - 1.0
        remarks.append(ReadingMessage.WHITE_IS_ZERO(largest=int(added)))
    elif photometric == MIN_IS_WHITE:
        remarks.append(ReadingMessage.WHITE_IS_ZERO_UNUSED())
    if orientation > 1:
        remarks.append(ReadingMessage.ORIENTATION(orientation=orientation))
    description = first.description if first.is_imagej and number_type.kind in "iu" else ""
    stated = _stated_function(where, description[:LONGEST_DESCRIPTION], str(tags.valueof(GDAL_METADATA, "")))
    scale, offset = stated.scale * factor, stated.scale * added + stated.offset
    return PageValues(scale, offset, orientation, (*remarks, *stated.remarks))


def _stated_function(where: str, of_imagej: str, of_gdal: str) -> PageValues:
    """Return the linear function that ImageJ's description or GDAL's metadata state."""
    function = dict(re.findall(r"^(cf|c0|c1)=(.*)$", of_imagej, re.MULTILINE))
    if "cf" not in function:
        packing = dict(re.findall(r'role="(scale|offset)"[^>]*>([^<]*)<', of_gdal[:LONGEST_DESCRIPTION]))
        return _linear(where, "GDAL (scale, offset)", packing.get("scale", "1"), packing.get("offset", "0"))
    if function["cf"] != STRAIGHT_LINE:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where} has the calibration function {quoted(function['cf'])!r} of ImageJ (cf), which is no straight "
            "line; export the calibrated values as 32-bit floating-point numbers",
        )
    return _linear(where, "ImageJ (c1, c0)", function.get("c1", "1"), function.get("c0", "0"))


def values_of_scale_file(name: str, text: bytes) -> PageValues:
    """Return what the file of the Core Imaging Library states of packed images: value = (stored - offset) / scale.

    Raises
    ------
    UnreadableScan
        `unsupported-storage`, when it states no numbers.
    """
    stated = dict(re.findall(r'"(scale|offset)":\s*([^\s,}]+)', text.decode("ascii", "replace")))
    return _linear(repr(name), name, stated.get("scale", ""), stated.get("offset", ""), inverse=True)


def _linear(where: str, names: str, scale: str, offset: str, *, inverse: bool = False) -> PageValues:
    """Return scale x number + offset, or the inverse of this, with a remark that names who states it."""
    try:
        factor, added = float(scale), float(offset)
        factor, added = (1.0 / factor, -added / factor) if inverse else (factor, added)
    except (ValueError, ZeroDivisionError):
        factor, added = 0.0, 0.0
    if not (factor and math.isfinite(factor) and math.isfinite(added)):
        raise UnreadableScan(
            "unsupported-storage",
            f"{where}: scale and offset of the stored numbers, by {names}, are {quoted(scale)!r} and "
            f"{quoted(offset)!r}; export the values as 32-bit floating-point numbers",
        )
    if (factor, added) == (1.0, 0.0):
        return PageValues()
    remark = ReadingMessage.PIXELS_UNPACKED(names=names, scale=f"{factor:.9g}", offset=f"{added:.9g}")
    return PageValues(factor, added, remarks=(remark,))
