"""Outliers lose weight: samples of dead and hot cells that the model cannot explain, and views that differ."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.covariance import CHANCE
from sawmill_tomography.calibration.joint_fit.finding import AdjustedFit, EffectFinding
from sawmill_tomography.calibration.joint_fit.normal_equations import ViewGrams
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel
from sawmill_tomography.calibration.joint_fit.structure import SHADOW
from sawmill_tomography.calibration.sinogram_data import FEW_VIEWS
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics import robust_deviation
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.scan_messages import AdjustmentMessage

# Outliers are a fault of the scan, and not a model error, when most of their power lies in cells, or in views, with
# more than this share of outlying samples (tests/tomography/calibration/test_adjust.py).
WHOLE = 0.2


def _adjust(plain: AdjustedFit) -> AdjustedFit:
    weighted = with_less_weight(plain, plain, plain.data.sinogram - plain.model)
    again = None if weighted is plain else plain.refitted(weighted.data, plain.fit)
    return plain if again is None else replace(weighted, fit=again)


def with_less_weight(current: AdjustedFit, plain: AdjustedFit, residual: FloatArray) -> AdjustedFit:
    """Return a plain fit's data in which outliers of this residual lose weight; the fit itself where they are few."""
    used = np.ones_like(residual) if plain.data.weights is None else plain.data.weights
    model, phantom = current.data.sinogram - residual, plain.phantom
    # The residual's robust deviation in the shadow, not in air, at least what the size tolerance leaves.
    depth = float(np.ptp(model))
    shadowed = residual[(model > current.fit.offset + SHADOW * depth) & (used > 0.0)]
    deviation = robust_deviation(shadowed - np.median(shadowed)) if shadowed.size else 0.0
    deviation = max(deviation, phantom.size_tolerance * depth)
    limit = CHANCE * (deviation or np.inf)
    outlying = np.abs(residual) > limit
    if not _is_a_fault(used, residual, outlying):
        return plain
    weights = used * np.divide(limit, residual, out=np.ones_like(residual), where=outlying) ** 2
    share_percent = 100.0 * float(outlying[used > 0.0].mean())
    data = replace(plain.data, weights=weights)
    return plain.after(data, plain.fit, AdjustmentMessage.OUTLIERS(share_percent=share_percent))


def _is_a_fault(used: FloatArray, residual: FloatArray, outlying: NDArray[np.bool_]) -> bool:
    """Return whether outliers are whole cells or whole views, as with faults; otherwise the model is wrong."""
    cells, views = outlying.mean(axis=0) > WHOLE, outlying.mean(axis=1) > WHOLE
    if not cells.any() and not views.any():
        return False
    power = used * outlying * residual**2
    return bool(2.0 * max(power[:, cells].sum(), power[views].sum()) > power.sum())


OUTLIERS = EffectFinding(Adjustment.OUTLIERS, _adjust)


# A view is inconsistent when its neighbouring cells share more than INCONSISTENT times the views' residual power
# (median), if at most the share FEW_VIEWS of the views does. An error of a drawing shows in all views, and at most
# three times as strongly in some (benchmarks/misspecified.py at 3ab7f653).
INCONSISTENT = 3.0
# Neighbouring cells must also share more than this share of the sinogram, as RMS: a model that is finer than the scan
# leaves less, unequally in the views.
LEAST = 0.01


def inconsistent_views(model: ScanModel) -> NDArray[np.bool_]:
    """Find the views, (views,) bool, that do not fit the rest, from a fit's residual; none where there are too many."""
    residual, data = model.residual, model.data
    used = residual if data.weights is None else np.sqrt(data.weights) * residual
    # Neighbouring cells do not share noise, however strong in deep shadow, but share errors of the model.
    shared, power = (used[:, 1:] * used[:, :-1]).sum(axis=1), (used**2).sum(axis=1)
    if not power.any():
        return np.zeros(len(residual), bool)
    least = max(INCONSISTENT * float(np.median(power[power > 0.0])), used.shape[1] * (LEAST * data.sinogram.std()) ** 2)
    inconsistent: NDArray[np.bool_] = shared > least
    return inconsistent if inconsistent.sum() <= FEW_VIEWS * len(inconsistent) else np.zeros_like(inconsistent)


# What each view may have of its own, as a gain or a turn, is fitted when it explains more than chance by this number of
# standard deviations.
BY_FAR = 8.0


def views_differ(grams: ViewGrams) -> bool:
    """Return whether a gain and an offset of each view explain far more than chance, most of what is structured."""
    explained, views = grams.gain_evidence()
    unknowns = 2.0 * views
    variance = (grams.power - explained) / max(grams.samples - unknowns, 1.0)
    chance = unknowns + BY_FAR * math.sqrt(2.0 * unknowns)
    return explained > chance * variance and 2.0 * (explained - unknowns * variance) > grams.structured
