"""Images as arrays, for programs and for viewers that apply a grey window themselves."""

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sawmill_calibration.pictures.pages import encoded
from sawmill_calibration.pictures.windows import Window, by_stripes, painted, to_unit, window_of
from sawmill_vocabulary import ColorMap

THUMBNAIL_PX = 160
Float32 = NDArray[np.float32]


def averaged(image: NDArray[np.floating[Any]], factor: int) -> Float32:
    """Average blocks of factor x factor pixels; an incomplete last block is averaged over the pixels that it has.

    Parameters
    ----------
    image : (x, y) float
    factor : int
        Side of a block, 1 or more; 1 leaves the image unchanged.

    Returns
    -------
    (ceil(x / factor), ceil(y / factor)) float32
    """
    single = image.astype(np.float32, copy=False)
    return single if factor == 1 else np.asarray(Image.fromarray(single).reduce(factor))


def npy(values: NDArray[Any]) -> bytes:
    """Return the bytes of an NPY file, version 1.0 (numpy.org, NEP 1), in C order."""
    stream = BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(values), version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def thumbnail_png(image: NDArray[np.floating[Any]], window: Window | None = None) -> bytes:
    """Draw a small square grey picture with nothing around the image, for an image of any shape.

    Parameters
    ----------
    image : (row, column) float
    window : (low, high), optional
        Values shown black and white; the 0.1 and 99.9 percentiles by default.
    """
    return encoded(Image.fromarray(painted(small_square(image, THUMBNAIL_PX, window), ColorMap.GREY)))


def small_square(image: NDArray[np.floating[Any]], side_px: int, window: Window | None = None) -> Float32:
    """Reduce an image of any shape to a square, from 0 for black to 1 for white; the window as in `thumbnail_png`."""
    shown = window or window_of(image)
    small = Image.fromarray(by_stripes(image, lambda stripe: to_unit(stripe, shown).astype(np.float32)))
    return np.asarray(small.resize((side_px, side_px), Image.Resampling.BOX))


def grey_png(grey: bytes, side_px: int) -> bytes:
    """Encode a square picture of one byte for each pixel, from 0 for black to 255 for white."""
    return encoded(Image.frombytes("L", (side_px, side_px), grey))
