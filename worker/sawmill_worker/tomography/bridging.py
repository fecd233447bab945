"""Faulty cells bridged from their neighbours."""

import numpy as np
from numpy.typing import NDArray


def bridge(sinogram: NDArray[np.floating], faulty: NDArray[np.bool_]) -> None:
    """Replace faulty cells by linear interpolation along the detector, in place; at an end by the nearest good one.

    Parameters
    ----------
    sinogram : (views, cells)
    faulty : (cells,) bool
        Not all of them.
    """
    good, bad = np.flatnonzero(~faulty), np.flatnonzero(faulty)
    right = np.clip(np.searchsorted(good, bad), 1, max(good.size - 1, 1))
    low, high = good[right - 1], good[np.minimum(right, good.size - 1)]
    share = np.clip((bad - low) / np.maximum(high - low, 1), 0.0, 1.0).astype(sinogram.dtype)
    sinogram[:, bad] = (1.0 - share) * sinogram[:, low] + share * sinogram[:, high]
