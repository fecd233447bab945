"""A few views that the fit to the others does not explain: the phantom or the turntable stood elsewhere."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.faults.finding import AdjustedFit
from sawmill_tomography.geometry.geometry import FloatArray

# A view is inconsistent when its neighbouring cells share more than this multiple of the views' residual power
# (median), if no more than this share of the views is. What is wrong with a drawing shows in all views, and at most
# three times as strongly in some (benchmarks/misspecified.py).
INCONSISTENT, MOST_VIEWS = 3.0, 0.1
# And this share of the sinogram, as RMS: a model that is finer than the scan leaves less, in some views more than in
# others.
LEAST = 0.01


def inconsistent_views(residual: FloatArray, sinogram: FloatArray, weights: FloatArray | None) -> NDArray[np.bool_]:
    """Which views, (views,), do not fit the others, by what a fit leaves of them; none where too many do not."""
    used = residual if weights is None else np.sqrt(weights) * residual
    # Noise, however strong in deep shadow, is not shared by neighbours; what a model lacks is.
    shared, power = (used[:, 1:] * used[:, :-1]).sum(axis=1), (used**2).sum(axis=1)
    if not power.any():
        return np.zeros(len(residual), bool)
    least = max(INCONSISTENT * float(np.median(power[power > 0.0])), residual.shape[1] * (LEAST * sinogram.std()) ** 2)
    found: NDArray[np.bool_] = shared > least
    return found if found.sum() <= MOST_VIEWS * len(found) else np.zeros_like(found)


def without_views(now: AdjustedFit, views: NDArray[np.bool_]) -> AdjustedFit | None:
    """The plain fit again, these views left out; None where there is none."""
    weights = np.ones_like(now.data.sinogram) if now.data.weights is None else now.data.weights
    remaining = replace(now.data, weights=np.where(views[:, None], 0.0, weights))
    again = now.refitted(remaining, now.fit)
    return None if again is None else replace(now, data=remaining, fit=again)


def sentence(number: int) -> str:
    """What is reported of it."""
    return f"{number} views that do not fit the others were left out"
