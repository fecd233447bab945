"""Angles that scatter from view to view."""

import math

import numpy as np

from sawmill_tomography.calibration.joint_fit.normal_equations import System
from sawmill_tomography.calibration.joint_fit.scan_model import Term
from sawmill_tomography.geometry.geometry import FloatArray

# Noise does not explain the scatter when it is larger by DEVIATIONS standard deviations, with FEWEST_VIEWS or more. An
# error of the model does not explain the scatter when neighbouring views share less than the share SHARED of it, u_c
# scatters independently by less than the share COLUMN, the median view has more than the share IN_MOST, and the scatter
# explains more than the share EXPLAINED of the structured residual.
MEDIAN_OF_CHI_SQUARED, IN_MOST, EXPLAINED = 0.455, 0.3, 0.4
DEVIATIONS, FEWEST_VIEWS, SHARED, COLUMN = 8.0, 20, 0.3, 0.1


def angle_scatter(system: System, change: FloatArray, variance: float) -> float:
    """Estimate the variance of the views' angles, rad^2; 0 where noise or a wrong model explains the scores."""
    psi, u_c = (next(i for i, c in enumerate(system.columns) if c.term is term) for term in (Term.PSI, Term.U_C))
    grams, scores = system.grams, system.scores - system.grams @ change
    own = grams[:, psi, psi]
    seen = own > 1e-9 * own.max()
    if seen.sum() < FEWEST_VIEWS or variance <= 0.0:
        return 0.0
    own, cross, score = own[seen], grams[seen, psi, u_c], scores[seen, psi]
    unit = score / np.sqrt(own * variance)
    excess = float((unit**2 - 1.0).sum())
    neighbours = float((unit[1:] * unit[:-1]).sum())
    remaining = scores[seen, u_c] - cross / own * score
    along = grams[seen, u_c, u_c]
    # Only rounding remains where turning and shifting the view have the same effect.
    apart = np.maximum(along - cross**2 / own, np.finfo(np.float64).eps * along.max())
    column_excess = float((remaining**2 / (apart * variance) - 1.0).sum())
    # Where a model is finer than the scan, one view with an edge along the rays may have most of the scatter.
    usual = float(np.median(unit**2)) / MEDIAN_OF_CHI_SQUARED - 1.0
    chance = DEVIATIONS * math.sqrt(2.0 * unit.size)
    structured = system.structured - float(change @ system.score)
    if (
        excess < chance
        or excess * variance < EXPLAINED * structured
        or usual * unit.size < IN_MOST * excess
        or abs(neighbours) > SHARED * excess
        or column_excess > max(COLUMN * excess, 0.5 * chance)
    ):
        return 0.0
    return float((score**2 - own * variance).sum() / (own**2).sum())
