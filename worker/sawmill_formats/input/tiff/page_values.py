"""Meaning of the numbers of a TIFF's page: tags and descriptions that change the values or flip the image.

Layout: Adobe, "TIFF Revision 6.0", section 8. ImageJ's description states a function of the stored numbers.
"""

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import as_float32
from sawmill_formats.input.scaling import Scaling
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

if TYPE_CHECKING:
    import tifffile

BITS_PER_SAMPLE, PHOTOMETRIC, ORIENTATION = 258, 262, 274
MIN_IS_WHITE, STRAIGHT_LINE = 0, "0"
COLOURS = {3: "a palette", 32803: "a colour filter"}
# Orientations that begin at the right, and at the bottom; above 4 rows are stored as columns.
FROM_RIGHT, FROM_BOTTOM, LARGEST_ORIENTATION = {2, 3}, {3, 4}, 4
LONGEST_DESCRIPTION = 4096


@dataclass(frozen=True)
class PageValues:
    """Steps from the stored numbers of a page to the image that it means, and remarks on them."""

    scaling: Scaling
    orientation: int
    remarks: tuple[Reason, ...]

    def image(self, stored: NDArray[Any]) -> NDArray[np.float32]:
        """Return the image (rows, detector) float32 that the stored numbers mean; they may be changed."""
        along_rows, along_cells = (-1 if self.orientation in of else 1 for of in (FROM_BOTTOM, FROM_RIGHT))
        return as_float32(self.scaling.apply(stored))[::along_rows, ::along_cells]


def page_values(page: "tifffile.TiffPage | tifffile.TiffFrame", where: str) -> PageValues:
    """Read what tags and the first page's description state: `wrong-type`, `unsupported-storage`."""
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
    stated = Scaling()
    if first.is_imagej and number_type.kind in "iu":
        stated = _function_of_imagej(where, first.description[:LONGEST_DESCRIPTION])
    scaling = Scaling(stated.scale * factor, stated.scale * added + stated.offset)
    return PageValues(scaling, orientation, (*remarks, *stated.remarks()))


def _function_of_imagej(where: str, description: str) -> Scaling:
    function = dict(re.findall(r"^(cf|c0|c1)=(.*)$", description, re.MULTILINE))
    curve = function.setdefault("cf", STRAIGHT_LINE)
    if curve != STRAIGHT_LINE:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where} has the calibration function {quoted(curve)!r} of ImageJ (cf), which is no straight line; export "
            "the calibrated values as 32-bit floating-point numbers",
        )
    return stated_scaling(where, "ImageJ (c1, c0)", function.get("c1", "1"), function.get("c0", "0"))


def stated_scaling(where: str, names: str, scale: str, offset: str, *, inverse: bool = False) -> Scaling:
    """Return scale x number + offset, or the inverse of this, as a file's texts state it: `unsupported-storage`."""
    scaling = Scaling.of(names, _number(scale), _number(offset), inverse=inverse)
    if scaling is None:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where}: scale and offset of the stored numbers, by {names}, are {quoted(scale)!r} and "
            f"{quoted(offset)!r}; export the values as 32-bit floating-point numbers",
        )
    return scaling


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan
