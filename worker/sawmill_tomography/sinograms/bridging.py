"""Faulty cells bridged from their neighbours."""

import numpy as np
from numpy.typing import NDArray

# The view, the first cell and the number of neighbouring samples of a view.
Run = tuple[int, int, int]


def runs_of(left_out: NDArray[np.bool_]) -> list[Run]:
    """Return the runs of samples that are left out, (views, cells), by view."""
    edges = np.diff(left_out.astype(np.int8), axis=1, prepend=0, append=0)
    (view, first), (_, end) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    return list(zip(view.tolist(), first.tolist(), (end - first).tolist(), strict=True))


def bridge(sinogram: NDArray[np.floating], faulty: NDArray[np.bool_]) -> None:
    """Replace faulty cells by linear interpolation along the detector, in place; at an end by the nearest good one.

    `sinogram` (views, cells). `faulty` (cells,) bool: True for faulty cells, at least one False.
    """
    good, bad = np.flatnonzero(~faulty), np.flatnonzero(faulty)
    right = np.clip(np.searchsorted(good, bad), 1, max(good.size - 1, 1))
    low, high = good[right - 1], good[np.minimum(right, good.size - 1)]
    share = np.clip((bad - low) / np.maximum(high - low, 1), 0.0, 1.0).astype(sinogram.dtype)
    sinogram[:, bad] = (1.0 - share) * sinogram[:, low] + share * sinogram[:, high]


def bridged_samples(sinogram: NDArray[np.floating], left_out: NDArray[np.bool_]) -> NDArray[np.floating]:
    """Return a copy in which samples are interpolated linearly along the detector; at an end, the nearest good one.

    `sinogram` (..., cells). `left_out` (..., cells) bool: True for samples to interpolate. A row that is left out as a
    whole stays as it is.
    """
    cells = sinogram.shape[-1]
    at = np.broadcast_to(np.arange(cells), sinogram.shape)
    low = np.maximum.accumulate(np.where(left_out, -1, at), axis=-1)
    high = np.minimum.accumulate(np.where(left_out, cells, at)[..., ::-1], axis=-1)[..., ::-1]
    whole = (low < 0) & (high >= cells)
    low, high = np.where(low < 0, high, low), np.where(high >= cells, low, high)
    low, high = (np.where(whole, at, end) for end in (low, high))
    share = ((at - low) / np.maximum(high - low, 1)).astype(sinogram.dtype)
    left, right = (np.take_along_axis(sinogram, end, axis=-1) for end in (low, high))
    filled: NDArray[np.floating] = np.where(left_out, (1 - share) * left + share * right, sinogram)
    return filled
