"""Dead and hot detector cells, found in one row's sinogram."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

Cells = NDArray[np.bool_]
Sinogram = NDArray[np.float32]

# A cell stands out when the middle of its values departs from its neighbours' by so many robust standard deviations,
# and by this share of the row's range: a shadow's edge departs less, since a median keeps edges.
DEVIATIONS, SHARE_OF_RANGE = 20.0, 0.06
NEIGHBOURS = 11
# More cells than this share standing out are the object's structure, not faults.
MOST_FAULTY = 0.05


def middle_of_views(sinogram: Sinogram) -> Sinogram:
    """The median over the views (cells,) of a sinogram (views, cells), the upper one of an even number."""
    middle: Sinogram = np.sort(np.ascontiguousarray(sinogram.T), axis=1)[:, len(sinogram) // 2]
    return middle


def faulty_cells(sinogram: Sinogram) -> Cells:
    """Cells (cells,) of a sinogram (views, cells) that stand out from their neighbours, or never change amid others.

    Nothing is reported where more than a twentieth of the cells stand out.
    """
    changing = np.ptp(sinogram, axis=0) > 0.0
    if not changing.any():
        return np.zeros(changing.size, bool)
    middle = middle_of_views(sinogram) + sinogram.mean(axis=0)
    departure = np.abs(middle - median_filter(middle, NEIGHBOURS, mode="nearest"))
    spread = 1.4826 * float(np.median(departure))
    low, high = np.quantile(middle, [0.02, 0.98])
    most = max(DEVIATIONS * spread, SHARE_OF_RANGE * float(high - low))
    faulty: Cells = departure > most
    if faulty.any() and not faulty.all():
        # On a slope a hot cell moves its neighbours' median too: looked at again without it, they are sound.
        at = np.arange(faulty.size)
        smooth = np.interp(at, at[~faulty], middle[~faulty])
        faulty &= np.abs(middle - median_filter(smooth, NEIGHBOURS, mode="nearest")) > most
    # Air may be free of noise: a cell that stands still has no signal only between cells that do not.
    first, last = np.flatnonzero(changing)[[0, -1]]
    faulty[first : last + 1] |= ~changing[first : last + 1]
    return faulty if faulty.mean() <= MOST_FAULTY else np.zeros_like(faulty)
