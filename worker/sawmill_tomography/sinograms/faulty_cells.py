"""Dead and hot detector cells, found in one row's sinogram."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sawmill_tomography.statistics import robust_deviation

Cells = NDArray[np.bool_]

# A cell is faulty if its middle value departs from its neighbours' by this number of robust standard deviations, and by
# this share of the row's range. A shadow's edge departs less: a median filter keeps edges
# (tests/tomography/test_faulty_cells.py; test_adjust.py for scans of the phantom).
DEVIATIONS, SHARE_OF_RANGE = 20.0, 0.06
# Width of the median filter, in cells.
NEIGHBOURS = 11
# If more cells than this share are found, they are the object's structure and not faults
# (tests/tomography/test_faulty_cells.py).
MOST_FAULTY = 0.05


def median_of_views(sinogram: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the median over the views (cells,) of a sinogram (views, cells): the upper one of an even number."""
    middle: NDArray[np.float32] = np.sort(np.ascontiguousarray(sinogram.T), axis=1)[:, len(sinogram) // 2]
    return middle


def faulty_cells(
    sinogram: NDArray[np.floating],
    median: NDArray[np.floating],
    *,
    recheck: bool = True,
    most_faulty: float = MOST_FAULTY,
) -> Cells:
    """Find cells that differ from their neighbours, or never change between cells that do.

    `sinogram` (views, cells), line integrals. `median` (cells,): median of each cell over the views. Returns (cells,)
    bool.
    """
    changing = np.ptp(sinogram, axis=0) > 0.0
    if not changing.any():
        return np.zeros(changing.size, bool)
    middle = median + sinogram.mean(axis=0)
    departure = np.abs(middle - _median_filter(middle))
    low, high = np.quantile(middle, [0.02, 0.98])
    threshold = max(DEVIATIONS * robust_deviation(departure), SHARE_OF_RANGE * float(high - low))
    faulty: Cells = departure > threshold
    if recheck and faulty.any() and not faulty.all():
        at = np.arange(faulty.size)
        smooth = np.interp(at, at[~faulty], middle[~faulty])
        faulty &= np.abs(middle - _median_filter(smooth)) > threshold
    # Air may be free of noise: a cell without changes has no signal only where it lies between cells that change.
    first, last = np.flatnonzero(changing)[[0, -1]]
    faulty[first : last + 1] |= ~changing[first : last + 1]
    return faulty if faulty.mean() <= most_faulty else np.zeros_like(faulty)


def _median_filter(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Take the median of `NEIGHBOURS` cells around each, the end cells repeated beyond the ends.

    It replaces `scipy.ndimage`'s filter, whose import would delay each start of a calibration.
    """
    windows = sliding_window_view(np.pad(values, NEIGHBOURS // 2, mode="edge"), NEIGHBOURS)
    middle: NDArray[np.floating] = np.sort(windows, axis=1)[:, NEIGHBOURS // 2]
    return middle
