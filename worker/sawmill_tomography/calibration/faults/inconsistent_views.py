"""Views that differ from the rest: their position, or their gain and background, as when the tube's output drifts."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.faults.finding import AdjustedFit
from sawmill_tomography.calibration.joint_fit.normal_equations import ViewGrams
from sawmill_tomography.geometry.geometry import FloatArray

# A view is inconsistent when its neighbouring cells share more than INCONSISTENT times the views' residual power
# (median), if at most the share MOST_VIEWS of the views does. An error of a drawing shows in all views, and at most
# three times as strongly in some (benchmarks/misspecified.py at 3ab7f653).
INCONSISTENT, MOST_VIEWS = 3.0, 0.1
# Neighbouring cells must also share more than this share of the sinogram, as RMS: a model that is finer than the scan
# leaves less, unequally in the views.
LEAST = 0.01


def inconsistent_views(residual: FloatArray, sinogram: FloatArray, weights: FloatArray | None) -> NDArray[np.bool_]:
    """Find the views, (views,) bool, that do not fit the rest, from a fit's residual; none where there are too many."""
    used = residual if weights is None else np.sqrt(weights) * residual
    # Neighbouring cells do not share noise, however strong in deep shadow, but share errors of the model.
    shared, power = (used[:, 1:] * used[:, :-1]).sum(axis=1), (used**2).sum(axis=1)
    if not power.any():
        return np.zeros(len(residual), bool)
    least = max(INCONSISTENT * float(np.median(power[power > 0.0])), residual.shape[1] * (LEAST * sinogram.std()) ** 2)
    inconsistent: NDArray[np.bool_] = shared > least
    return inconsistent if inconsistent.sum() <= MOST_VIEWS * len(inconsistent) else np.zeros_like(inconsistent)


def without_views(adjusted: AdjustedFit, views: NDArray[np.bool_]) -> AdjustedFit | None:
    """Repeat the plain fit without these views; None where the fit does not converge."""
    weights = np.ones_like(adjusted.data.sinogram) if adjusted.data.weights is None else adjusted.data.weights
    remaining = replace(adjusted.data, weights=np.where(views[:, None], 0.0, weights))
    again = adjusted.refitted(remaining, adjusted.fit)
    return None if again is None else replace(adjusted, data=remaining, fit=again)


# Gains of each view are fitted when they explain more than chance by DEVIATIONS standard deviations, and more than the
# share LEAST_SHARE of the structured residual.
DEVIATIONS, LEAST_SHARE = 8.0, 0.5


def views_differ(grams: ViewGrams) -> bool:
    """Return whether a gain and an offset of each view explain far more than chance."""
    explained, views = grams.gain_evidence()
    unknowns = 2.0 * views
    variance = (grams.power - explained) / max(grams.samples - unknowns, 1.0)
    chance = unknowns + DEVIATIONS * math.sqrt(2.0 * unknowns)
    return explained > chance * variance and explained - unknowns * variance > LEAST_SHARE * grams.structured
