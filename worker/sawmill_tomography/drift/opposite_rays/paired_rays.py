"""Paired rays: every ray of a full turn with the one measured in the opposite direction along the same line.

chi is the direction of a ray in the plane, as the angle of a parallel beam (docs/understand/drift.md#dense-scans).
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray, Scanner, cell_centres_mm

# Below this share of signal in the slopes, in the worst direction, the reported errors are too small (a fifth at 0.2).
SIGNAL_SHARE = 0.3


class Derivatives(NamedTuple):
    """Derivatives of half the sums of opposite rays, each (derivatives, pairs, chi) float64.

    The first is the derivative by gamma at fixed chi, the second the one by chi; multiples of both may follow.
    """

    plain: FloatArray  # not blurred over chi, where white noise of the views is white
    blurred: FloatArray  # blurred twice over chi, and 0 where a ray of the pair is not used
    noise: FloatArray
    noise_blurred: FloatArray

    def with_mean(self, by_gamma: FloatArray, used: NDArray[np.bool_]) -> "Derivatives":
        """Add the derivative by gamma (pairs,) of the views' mean, which does not depend on chi."""
        mean = np.stack([np.broadcast_to(by_gamma[:, None], used.shape), np.zeros(used.shape)])
        return self._replace(plain=self.plain + mean, blurred=self.blurred + mean * used)


@dataclass(frozen=True, eq=False)
class PairedRays:
    """Differences of opposite rays (pairs, chi), and their derivatives by the unknowns.

    The unknowns are (u_c, tau, SDD), optionally followed by further ones.
    """

    difference: FloatArray  # differences, not blurred over chi
    derivatives: Derivatives
    weights: FloatArray  # (unknowns, derivatives, pairs): weight of each derivative in the slope by an unknown
    used: NDArray[np.bool_]  # True for pairs of which both rays were measured

    def with_unknowns(self, derivatives: Derivatives, chosen: list[int], slopes: FloatArray) -> "PairedRays":
        """Append unknowns whose slopes are the chosen derivatives, each times (chosen, pairs, chi)."""
        count, more = self.weights.shape[1], len(chosen)
        joined = np.empty((len(derivatives), count + more, *self.used.shape))
        for both, own, further in zip(joined, self.derivatives, derivatives, strict=True):
            both[:count] = own
            for row, one, slope in zip(both[count:], chosen, slopes, strict=True):
                np.multiply(further[one], slope, out=row)
        weights = np.pad(self.weights, ((0, more), (0, more), (0, 0)))
        weights[-more:, -more:] = np.eye(more)[:, :, None]
        return replace(self, derivatives=Derivatives(*joined), weights=weights)

    @property
    def slopes(self) -> FloatArray:
        """Derivatives of half the sums by the unknowns, (unknowns, pairs, chi)."""
        return np.asarray(np.einsum("xip,ipt->xpt", self.weights, self.derivatives.plain))

    @property
    def instruments(self) -> FloatArray:
        """Slopes of blurred rays, (unknowns, pairs, chi)."""
        return np.asarray(np.einsum("xip,ipt->xpt", self.weights, self.derivatives.blurred))

    @cached_property
    def scores(self) -> FloatArray:
        """Instruments times differences at each chi, (chi, unknowns)."""
        products = self.derivatives.blurred * self.difference
        unknowns, chi = len(self.weights), products.shape[-1]
        return (self.weights.reshape(unknowns, -1) @ products.reshape(-1, chi)).T

    def gram(self, *, corrected: bool) -> FloatArray:
        """Return the products of instruments and slopes, (unknowns, unknowns).

        Both come from noisy data, and their noise makes the matrix too large (errors in variables). `corrected`
        subtracts the noise's share, which half the differences show.
        """
        return self._gram - self._noise_gram if corrected else self._gram

    @cached_property
    def _gram(self) -> FloatArray:
        return _products(self.weights, self.derivatives.blurred, self.derivatives.plain)

    @cached_property
    def _noise_gram(self) -> FloatArray:
        return _products(self.weights, self.derivatives.noise_blurred, self.derivatives.noise)

    def covariance(self, free: slice | list[int], *, corrected: bool, correlated: float = 0.0) -> FloatArray:
        """Compute the heteroscedasticity-robust covariance (White 1980) of the free unknowns, from each chi's score.

        Scores within a share `correlated` of the turn count as correlated, with Bartlett's weights (Newey and West
        1987, Econometrica 55, 703). The covariance is infinite where the pairs do not show the unknowns.
        """
        gram, noisy = (self.gram(corrected=kind)[free][:, free] for kind in (corrected, False))
        both = gram + gram.T, noisy + noisy.T  # a mask makes both a bit asymmetric
        # The signal's smallest share of the noisy matrix in any direction.
        if not (is_definite(both[1]) and scipy.linalg.eigh(*both, eigvals_only=True)[0] > SIGNAL_SHARE):
            return np.full(gram.shape, math.inf)
        scores = self.scores[:, free]
        bread = np.linalg.inv(gram)
        products, lags = scores.T @ scores, int(correlated * len(scores))
        for lag in range(1, lags + 1):
            shifted = scores.T @ np.roll(scores, lag, axis=0)
            products += (1.0 - lag / (lags + 1)) * (shifted + shifted.T)
        return bread @ products @ bread.T


def fan_angles(scanner: Scanner, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each cell's fan angle (cells,) and the angle that the cell covers."""
    u_c, tau, sdd = vector
    w = cell_centres_mm(scanner) - u_c
    across, along = w * math.cos(tau), sdd + w * math.sin(tau)
    return np.arctan2(across, along), sdd * math.cos(tau) * scanner.detector_pitch_mm / (across**2 + along**2)


def is_definite(gram: FloatArray) -> bool:
    """Return whether a matrix of products is positive definite beyond rounding, independent of the unknowns' scales."""
    diagonal = np.diag(gram)
    if not np.all(diagonal > 0.0):
        return False
    scale = 1.0 / np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(gram * np.outer(scale, scale))[0] > 1e-6)


def _products(weights: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    """Sum products of weighted derivatives over pairs and chi: over chi first, where no weight changes."""
    of_pairs, of_unknowns = left.transpose(1, 0, 2) @ right.transpose(1, 2, 0), weights.transpose(2, 0, 1)
    return np.asarray((of_unknowns @ of_pairs @ of_unknowns.transpose(0, 2, 1)).sum(axis=0))
