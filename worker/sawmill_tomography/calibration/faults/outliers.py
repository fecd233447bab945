"""Outliers: samples of dead and hot cells and of corrupt views, which the model cannot explain, lose weight."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.faults.finding import AdjustedFit, EffectFinding
from sawmill_tomography.calibration.faults.structure import SHADOW
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics import robust_deviation
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.scan_messages import AdjustmentMessage

# A residual of more robust standard deviations makes a sample lose weight.
OUTLIER = 4.0
# Outliers are reweighted when they have this share of the residual's power.
OUTLIER_POWER = 0.25
# Outliers are a fault of the scan, and not a model error, when most of their power (FAULT_SHARE) lies in cells, or in
# views, with more than the share WHOLE of outlying samples (tests/tomography/calibration/test_adjust.py).
WHOLE, FAULT_SHARE = 0.2, 0.7
# The fit is repeated, since outliers bias the first fit.
ROUNDS = 2


def _adjust(plain: AdjustedFit) -> AdjustedFit:
    current, share = plain, 0.0
    used = np.ones_like(plain.data.sinogram) if plain.data.weights is None else plain.data.weights
    for _ in range(ROUNDS):
        residual = current.data.sinogram - current.model
        deviation = _deviation(current, residual, used)
        if deviation == 0.0:
            return plain
        size, power = np.abs(residual) / deviation, used * residual**2
        outlying = size > OUTLIER
        if power[outlying].sum() < OUTLIER_POWER * power.sum() or not _is_a_fault(power * outlying, outlying):
            break
        weighted = replace(current.data, weights=used * np.where(outlying, (OUTLIER / size) ** 2, 1.0))
        again = plain.refitted(weighted, current.fit)
        if again is None:
            break
        current, share = replace(plain, data=weighted, fit=again), float(outlying[used > 0.0].mean())
    if share == 0.0:
        return plain
    return plain.after(current.data, current.fit, AdjustmentMessage.OUTLIERS(share_percent=100.0 * share))


def _deviation(adjusted: AdjustedFit, residual: FloatArray, used: FloatArray) -> float:
    """Compute the residual's robust standard deviation in the shadow, at least what the size tolerance leaves.

    Air does not count: air may be free of noise, and covers most of a sinogram.
    """
    depth = float(np.ptp(adjusted.model))
    shadowed = residual[(adjusted.model > adjusted.fit.offset + SHADOW * depth) & (used > 0.0)]
    deviation = robust_deviation(shadowed - np.median(shadowed)) if shadowed.size else 0.0
    return max(deviation, adjusted.phantom.size_tolerance * depth)


def _is_a_fault(power: FloatArray, outlying: NDArray[np.bool_]) -> bool:
    """Return whether outliers are whole cells or whole views, as with faults; otherwise the model is wrong."""
    cells = power[:, outlying.mean(axis=0) > WHOLE].sum()
    views = power[outlying.mean(axis=1) > WHOLE].sum()
    return bool(max(cells, views) > FAULT_SHARE * power.sum())


OUTLIERS = EffectFinding(Adjustment.OUTLIERS, _adjust)
