"""Tests of effects next to a fit: each is judged by its own pattern, whatever the residual is."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from sawmill_tomography.calibration.joint_fit._derivatives_numba import largest_power
from sawmill_tomography.calibration.joint_fit.groups import ON_DETECTOR, STRUCTURES
from sawmill_tomography.calibration.joint_fit.normal_equations import SINGULAR, UNTRUSTED, System
from sawmill_tomography.calibration.joint_fit.scan_model import is_of_detector
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics import exceeded_chi_square

# Probability that chance alone shows an effect: below FITTED one that is switched off is reported, and the wood's
# density varies; below BEYOND_CHANCE effects of wood are looked at (benchmarks/mill.py at 3ab7f653).
FITTED, BEYOND_CHANCE = 1e-5, 0.01
# Numbers of blocks of neighbouring views whose scores are compared: errors of a model continue from view to view.
BLOCKS = (64, 32, 16, 8)


chance_limit = cache(exceeded_chi_square)


@dataclass(frozen=True, eq=False)
class EffectTest:
    """The test of an effect against a fit without this effect."""

    significance: float  # chi-square of the effect, against the largest of three variances
    power: float  # weighted power of the residual that the effect explains
    degrees: int  # number of the effect's unknowns that the scan distinguishes from the fitted ones
    sizes: FloatArray  # (columns,): sizes of the effect's columns, if the effect were fitted
    bias: FloatArray  # (base,): bias of the fitted columns, if the effect is real and not fitted

    @property
    def variance(self) -> float:
        """The variance against which the effect is significant; 0 where nothing is."""
        return self.power / self.significance if 0.0 < self.significance < np.inf else 0.0

    def is_beyond_chance(self, probability: float) -> bool:
        """Return whether chance alone would show an effect of this size with less than this probability."""
        return self.degrees > 0 and self.significance > chance_limit(probability, self.degrees)


class EffectTester:
    """Tests of further columns against a fit of the columns `base`."""

    def __init__(self, system: System, base: Sequence[int]) -> None:
        self._system, self._base = system, list(base)
        cross, inverse = system.normal[self._base], system.inverse(self._base)
        self._best = inverse @ system.score[self._base]
        self._explained = float(system.score[self._base] @ self._best)
        # Coefficients of every column's projection on the base's columns, and the normal equations that remain.
        self._sensitivity = inverse @ cross
        self._normal, self._score = system.normal - cross.T @ self._sensitivity, system.score - cross.T @ self._best

    def tested(self, tried: Sequence[int]) -> EffectTest:
        """Test these columns, which must have consecutive indices."""
        system, base, own = self._system, self._base, slice(tried[0], tried[-1] + 1)
        scale = system.scale[own]
        values, vectors = np.linalg.eigh(self._normal[own, own] * np.outer(scale, scale))
        kept = values > SINGULAR  # others are directions that the scan cannot distinguish
        # Independent unknowns (columns, degrees) with unit information each.
        white = np.ascontiguousarray(scale[:, None] * vectors[:, kept] / np.sqrt(values[kept]))
        score = white.T @ self._score[own]
        sizes, power, degrees = white @ score, float(score @ score), len(score)
        sensitivity = self._sensitivity[:, own] @ white
        bias = -sensitivity @ score
        explained = self._explained + power
        variance = max(system.power - explained, 0.0) / max(system.samples - len(base) - len(tried), 1.0)
        if variance <= 0.0 or degrees == 0:
            return EffectTest(np.inf if power > 0.0 and degrees > 0 else 0.0, power, degrees, sizes, bias)
        # The score scatters at least by noise: where noise explains the effect, no other scatter is computed.
        if power < variance * chance_limit(BEYOND_CHANCE, degrees):
            return EffectTest(power / variance, power, degrees, sizes, bias)
        # What the base leaves of the effect's columns, and each view's score at the best change.
        left, change = np.zeros((len(system.columns), degrees)), np.zeros(len(system.columns))
        left[base], left[own], change[base] = -sensitivity, white, self._best
        information, scores = system.of_views(left, change + left @ score)
        structured = max(system.structured - explained, UNTRUSTED * system.structured)
        scatter = _scatter(scores, information, variance)
        shares = ON_DETECTOR if all(is_of_detector(system.columns[place].term) for place in tried) else STRUCTURES
        return EffectTest(power / max(variance * scatter, structured / shares), power, degrees, sizes, bias)


def _scatter(scores: FloatArray, information: FloatArray, variance: float) -> float:
    """Compute the variance of the scores of unknowns of unit information against noise, at least 1.

    The score of a single view is taken at the change that the remaining views give (the jackknife; MacKinnon and White
    1985). Otherwise one view in which an edge lies along the rays would explain itself.

    The part that the change takes from the stripes is in no view's scores. This part is the mean of the scores, since
    the scores sum to 0 at the best change of generalised least squares, and is not scatter.

    `scores` (views, unknowns). `information` (views, unknowns, unknowns): information of each view; the sum over the
    views is the unit matrix.
    """
    degrees: int = scores.shape[1]
    # A view that alone determines an effect leaves nothing of the unit matrix.
    power = float(largest_power(scores - scores.mean(axis=0), information, 1.0 + SINGULAR, BLOCKS))
    return max(1.0, power / (variance * degrees))
