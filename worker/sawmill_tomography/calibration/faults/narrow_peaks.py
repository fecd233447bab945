"""Narrow and deep shadows in a sinogram: a phantom has none, metal has one in every view.

Narrow peaks are searched before anything is fitted, so that the search finds the phantom. The comparison with the
fitted model decides whether a peak is metal (`metal.py`).
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

# A peak is narrow when it exceeds the samples at this distance on the detector, on both sides.
WIDTH_MM = 12.0
# A peak is deep where the mean of three cells exceeds these samples by this share of the phantom's depth: in some scans
# of 2 000 photons and more the corners of sound phantoms reached 0.09 in one view of ten, screws of 5 mm 0.2 in half of
# the views.
DEEP = 0.15
# Fewer views with such peaks than this share are noise in the deepest shadow.
LEAST_VIEWS = 0.05
# This number of views shows whether there are any peaks.
FEW_VIEWS = 64
# Quantiles of the sinogram without its peaks, between which the phantom's depth lies.
QUANTILES = (0.02, 0.99)


def narrow_peaks(sinogram: FloatArray, views: NDArray[np.bool_], pitch_mm: float) -> NDArray[np.bool_] | None:
    """Find samples (views, cells) of narrow deep shadows with their surroundings; None where there are none.

    `sinogram` (views, cells): line integrals in any unit. `views` (views,) bool: usable views.
    """
    width = max(2, round(WIDTH_MM / pitch_mm))
    if sinogram.shape[1] <= 4 * width:
        return None
    few = slice(None, None, max(1, len(sinogram) // FEW_VIEWS))
    excess = _excess(sinogram[few], width)
    low, high = np.quantile(sinogram[few, width:-width] - np.maximum(excess, 0.0), QUANTILES)
    deep = DEEP * (high - low)
    if not high > low or _peaks(excess, deep)[views[few]].any(axis=1).mean() < LEAST_VIEWS:
        return None
    peaks = np.zeros(sinogram.shape, np.uint8)
    peaks[:, width + 1 : -width - 1] = _peaks(_excess(sinogram, width), deep)
    wide: NDArray[np.bool_] = scipy.ndimage.maximum_filter1d(peaks, width, axis=1, mode="constant") > 0
    return wide


def _excess(sinogram: FloatArray, width: int) -> FloatArray:
    """Compute by how much samples exceed samples `width` cells to either side, (views, cells less 2 widths)."""
    excess: FloatArray = sinogram[:, width:-width] - np.maximum(sinogram[:, : -2 * width], sinogram[:, 2 * width :])
    return excess


def _peaks(excess: FloatArray, deep: float) -> NDArray[np.bool_]:
    peaks: NDArray[np.bool_] = (excess[:, :-2] + excess[:, 1:-1] + excess[:, 2:]) > 3.0 * deep
    return peaks
