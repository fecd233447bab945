"""Which effects a scan shows: each judged by its own pattern, whatever else is in the residual."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from sawmill_worker.tomography.calibration.normal_equations import System
from sawmill_worker.tomography.geometry import FloatArray

# Probability with which chance alone shows an effect: below the first it is fitted, below the second its bias is in
# the covariance (benchmarks/mill.py).
FITTED, BEYOND_CHANCE = 1e-5, 0.01
# Blocks of neighbouring views whose scores are compared: what a model lacks goes on from view to view.
BLOCKS = (64, 32, 16, 8)
# Eigenvalues of a normal matrix of unit diagonal below this are directions that the scan does not tell from others.
SINGULAR = 1e-7
# What a drawing, or the wood, may be wrong in independently: of that part of the residual that is no noise every effect
# explains one such share by chance (tests/test_measured.py).
STRUCTURES = 100.0
# Of it so much remains at least: what a step explains is only known to first order.
UNTRUSTED = 0.1
# Of a view that alone determines an effect as much as is left by rounding.
RIDGE = 1e-6


@dataclass(frozen=True, eq=False)
class Test:
    """An effect beside those fitted.

    Attributes
    ----------
    significance : float
        Its chi-square, by whatever is largest: the noise, how its score scatters from block to block of the views, or
        its share of a residual that is no noise.
    power : float
        What it explains of the residual's, weighted.
    degrees : int
        Number of its unknowns that the scan tells from those fitted.
    sizes : (columns,) float64
        Of its columns, if it were fitted.
    bias : (base,) float64
        Of the fitted columns, if it is there and not fitted.
    """

    significance: float
    power: float
    degrees: int
    sizes: FloatArray
    bias: FloatArray

    def is_fitted(self, trials: float = 1.0) -> bool:
        """Whether it is far beyond chance, of this number of places where it may be."""
        return self.degrees > 0 and self.significance > float(chi2.isf(FITTED / trials, self.degrees))

    def is_beyond_chance(self, trials: float = 1.0) -> bool:
        """Whether chance alone would hardly show as much."""
        return self.degrees > 0 and self.significance > float(chi2.isf(BEYOND_CHANCE / trials, self.degrees))


def test_effect(system: System, base: Sequence[int], tried: Sequence[int]) -> Test:
    """Judge the columns `tried` beside the columns `base` of the fit."""
    base, tried = list(base), list(tried)
    inverse = system.inverse(base)
    best = inverse @ system.score[base]
    cross = system.normal[np.ix_(base, tried)]
    carried = inverse @ cross
    matrix = system.normal[np.ix_(tried, tried)] - cross.T @ carried
    scale = system.scale[tried]
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    kept = values > SINGULAR
    # Unknowns (columns, degrees) of which each has unit information, independent of the others.
    white = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    score = white.T @ (system.score[tried] - cross.T @ best)
    sizes = white @ score
    power = float(score @ score)
    remaining = max(system.power - float(system.score[base] @ best) - power, 0.0)
    variance = remaining / max(system.samples - len(base) - len(tried), 1.0)
    bias = -carried @ sizes
    if variance <= 0.0 or not kept.any():
        return Test(np.inf if power > 0.0 and kept.any() else 0.0, power, int(kept.sum()), sizes, bias)
    # It scatters by noise at least: where that explains it, no other scatter need be known.
    if power < variance * float(chi2.isf(BEYOND_CHANCE, kept.sum())):
        return Test(power / variance, power, int(kept.sum()), sizes, bias)
    change = np.zeros(len(system.columns))
    change[base], change[tried] = best + bias, sizes
    scores = system.scores - system.grams @ change
    basis = np.zeros((len(system.columns), white.shape[1]))
    basis[tried], basis[base] = white, -carried @ white
    information = np.swapaxes(system.grams @ basis, 1, 2) @ basis
    explained = float(system.score[base] @ best) + power
    structured = max(system.structured - explained, UNTRUSTED * system.structured)
    by_chance = max(variance * _scatter(scores @ basis, information, variance), structured / STRUCTURES)
    return Test(power / by_chance, power, int(kept.sum()), sizes, bias)


def _scatter(scores: FloatArray, information: FloatArray, variance: float) -> float:
    """How much more the scores (views, degrees) of unit information scatter than noise does, at least 1.

    From view to view they are those that would be seen without the view (the jackknife; MacKinnon and White 1985), or
    one view in which an edge lies along the rays would explain itself.
    """
    degrees = scores.shape[1]
    alone = np.linalg.solve(np.eye(degrees) * (1.0 + RIDGE) - information, scores[..., None])[..., 0]
    largest: float = max(1.0, float((alone**2).sum()) / (variance * degrees))
    for blocks in BLOCKS:
        if blocks < len(scores):
            first = np.linspace(0, len(scores), blocks, endpoint=False).astype(np.intp)
            power = float((np.add.reduceat(scores, first) ** 2).sum())
            largest = max(largest, power / (variance * degrees))
    return largest
