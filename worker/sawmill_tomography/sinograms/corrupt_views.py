"""Views that cannot belong to their scan: never filled, or outside of what the other views see."""

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

# A view is corrupt when this share of its samples is outside the range of the median view, or when its own range is
# less than this share of that range: a view that was never filled varies as the cells' gains do, by some 0.15.
VIEW_SHARE, FLAT_SHARE = 0.01, 0.05
FEWEST_VIEWS = 3


def usable_views(sinogram: FloatArray) -> NDArray[np.bool_]:
    """Find the views (views,) of a sinogram (views, detector) that are not corrupt; all where hardly one is not."""
    # Hot cells occur in every view: the highest hundredth of the samples is left out for them.
    quantiles = np.quantile(sinogram, [0.02, 0.99], axis=1)
    low, high = np.median(quantiles, axis=1).tolist()
    span = high - low
    outside = ((sinogram < low - 0.3 * span) | (sinogram > high + span)).mean(axis=1)
    flat = np.ptp(quantiles, axis=0) < FLAT_SHARE * span
    usable: NDArray[np.bool_] = (outside <= np.median(outside) + VIEW_SHARE) & ~flat
    return usable if usable.sum() >= FEWEST_VIEWS else np.ones_like(usable)
