"""An image of a log by some rays, which shows what the other rays would measure."""

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.total_variation import total_variation

# The constants of this file were measured with benchmarks/production_logs.py and benchmarks/log_metal.py.
# The errors of a ray by the pixels, as a share of the longest path, and the weight in 1 / the longest path's mean
# attenuation. A fixed weight costs a quarter of one that is chosen, and the errors in the other rays are the same.
PIXELS_SHARE, WEIGHT = 0.005, 10.0


def image_of_other_rays(projector: Projector, sinogram: Image, uncertainty: NDArray[np.floating]) -> Image:
    """Return the total-variation image (size, size), in 1/mm, of the rays that are known.

    `sinogram` (views, detector) float32: line integrals whose air is at 0, and estimates of some, from which the
    descent starts. `uncertainty` (views, detector) float: further standard deviation of each ray; infinite for
    estimates.
    """
    longest = float(sinogram.max())
    noise = np.hypot(longest * PIXELS_SHARE, uncertainty)
    return total_variation(projector, sinogram, noise=noise, weight=WEIGHT * projector.grid.field_mm / longest).image
