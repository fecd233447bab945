"""Which effects a scan shows: each judged by its own pattern, whatever else is in the residual."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from sawmill_tomography.calibration._derivatives_numba import largest_power, whiten
from sawmill_tomography.calibration.normal_equations import System
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics.chi_square import exceeded_chi_square

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


chance_limit = cache(exceeded_chi_square)


@dataclass(frozen=True, eq=False)
class EffectTest:
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
        return self.degrees > 0 and self.significance > chance_limit(FITTED / trials, self.degrees)

    def is_beyond_chance(self, trials: float = 1.0) -> bool:
        """Whether chance alone would hardly show as much."""
        return self.degrees > 0 and self.significance > chance_limit(BEYOND_CHANCE / trials, self.degrees)


class Beside:
    """The columns `base` of a fit, beside which others are judged."""

    def __init__(self, system: System, base: Sequence[int]) -> None:
        self._system, self._base = system, list(base)
        cross, inverse = system.normal[self._base], system.inverse(self._base)
        self._best = inverse @ system.score[self._base]
        self._explained = float(system.score[self._base] @ self._best)
        # Of every column what the base's take over of it, and what is left of the normal equations.
        self._carried = inverse @ cross
        self._normal, self._score = system.normal - cross.T @ self._carried, system.score - cross.T @ self._best

    @cached_property
    def _of_base(self) -> FloatArray:
        """Each view's inner products of the base's columns with all, (views, base, columns)."""
        return np.take(self._system.grams, self._base, axis=1)

    @cached_property
    def _scores(self) -> FloatArray:
        """Each view's, (views, columns), at the base's best change."""
        scores: FloatArray = self._system.scores - self._best @ self._of_base
        return scores

    def tested(self, tried: Sequence[int]) -> EffectTest:
        """Judge these columns, which stand one after another."""
        system, base, own = self._system, self._base, slice(tried[0], tried[-1] + 1)
        scale = system.scale[own]
        values, vectors = np.linalg.eigh(self._normal[own, own] * np.outer(scale, scale))
        kept = values > SINGULAR
        # Unknowns (columns, degrees) of which each has unit information, independent of the others.
        white = np.ascontiguousarray(scale[:, None] * vectors[:, kept] / np.sqrt(values[kept]))
        score = white.T @ self._score[own]
        sizes, power, degrees = white @ score, float(score @ score), len(score)
        carried = self._carried[:, own] @ white
        bias = -carried @ score
        explained = self._explained + power
        variance = max(system.power - explained, 0.0) / max(system.samples - len(base) - len(tried), 1.0)
        if variance <= 0.0 or degrees == 0:
            return EffectTest(np.inf if power > 0.0 and degrees > 0 else 0.0, power, degrees, sizes, bias)
        # It scatters by noise at least: where that explains it, no other scatter need be known.
        if power < variance * chance_limit(BEYOND_CHANCE, degrees):
            return EffectTest(power / variance, power, degrees, sizes, bias)
        scores, information = np.empty((len(system.scores), degrees)), np.empty((len(system.scores), degrees, degrees))
        whiten(
            system.grams,
            self._of_base,
            self._scores,
            np.array(base),
            own.start,
            white,
            carried,
            score,
            scores,
            information,
        )
        structured = max(system.structured - explained, UNTRUSTED * system.structured)
        scatter = _scatter(scores, information, variance)
        return EffectTest(power / max(variance * scatter, structured / STRUCTURES), power, degrees, sizes, bias)


def _scatter(scores: FloatArray, information: FloatArray, variance: float) -> float:
    """How much more the scores of unknowns of unit information scatter than noise does, at least 1.

    From view to view they are those that would be seen without the view (the jackknife; MacKinnon and White 1985), or
    one view in which an edge lies along the rays would explain itself.

    What the change takes from the stripes is in no view's scores. It is their mean, since their sum is 0 at the best
    change of generalised least squares, and no scatter.

    Parameters
    ----------
    scores : (views, unknowns)
    information : (views, unknowns, unknowns)
        Of each view; the sum over the views is 1.
    """
    degrees: int = scores.shape[1]
    power = float(largest_power(scores - scores.mean(axis=0), information, 1.0 + RIDGE, BLOCKS))
    return max(1.0, power / (variance * degrees))
