"""Images as arrays, for programs and for viewers that window them themselves."""

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sawmill_vocabulary import ColorMap
from sawmill_worker.pictures.color_maps import painted
from sawmill_worker.pictures.pages import encoded
from sawmill_worker.pictures.windows import Window, to_unit, window_of

THUMBNAIL_PX = 160
Float32 = NDArray[np.float32]


def averaged(image: NDArray[np.floating[Any]], factor: int) -> Float32:
    """Each block of factor x factor pixels as its mean; a last block that is not whole, as the mean of what is there.

    Parameters
    ----------
    image : (x, y) float
    factor : int
        1 or more; 1 leaves the image as it is.

    Returns
    -------
    (ceil(x / factor), ceil(y / factor)) float32
    """
    single = image.astype(np.float32, copy=False)
    return single if factor == 1 else np.asarray(Image.fromarray(single).reduce(factor))


def npy(values: NDArray[Any]) -> bytes:
    """The bytes of an NPY file, version 1.0 (numpy.org, NEP 1), in C order."""
    stream = BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(values), version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def thumbnail_png(image: NDArray[np.floating[Any]], window: Window | None = None) -> bytes:
    """A small square grey picture with nothing around it, whatever the shape of the image.

    Parameters
    ----------
    image : (row, column) float
    window : (low, high), optional
        Values shown black and white; the 0.1 and 99.9 percentiles by default.
    """
    side = (THUMBNAIL_PX, THUMBNAIL_PX)
    small = Image.fromarray(to_unit(image, window or window_of(image)).astype(np.float32))
    return encoded(Image.fromarray(painted(np.asarray(small.resize(side, Image.Resampling.BOX)), ColorMap.GREY)))
