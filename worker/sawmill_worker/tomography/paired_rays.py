"""Paired rays: every ray of a full turn beside the one that came the other way along the same line.

chi is the direction of a ray in the plane, as a parallel beam's angle is counted (docs/geometry.md#drift).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from sawmill_worker.tomography.geometry import FloatArray, Scanner, cell_centres_mm

# Below this share of signal in the slopes, in the worst direction, the stated errors are too small (a fifth at 0.2).
SIGNAL_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of half the sums of opposite rays by gamma at fixed chi and by chi, each (2, pairs, chi) float64.

    Attributes
    ----------
    plain, blurred : float64
        Not blurred over chi, and blurred twice where both rays are used.
    noise, noise_blurred : float64
        The same of half the differences, which carry as much noise as half the sums and no signal.
    """

    plain: FloatArray
    blurred: FloatArray
    noise: FloatArray
    noise_blurred: FloatArray

    def with_mean(self, by_gamma: FloatArray, used: NDArray[np.bool_]) -> "Derivatives":
        """With the derivative (pairs,) of the views' mean, which does not depend on chi."""
        mean = np.stack([np.broadcast_to(by_gamma[:, None], used.shape), np.zeros(used.shape)])
        return replace(self, plain=self.plain + mean, blurred=self.blurred + mean * used)

    def slopes(self, by_gamma: FloatArray, by_chi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Slopes, instruments, noise slopes and noise instruments of `PairedRays` for other unknowns.

        Parameters
        ----------
        by_gamma, by_chi : (unknowns, pairs, chi or 1)
            How much each unknown counts of either derivative.
        """
        slopes, instruments, noise_slopes, noise_instruments = (
            by_gamma * each[0] + by_chi * each[1] for each in (self.plain, self.blurred, self.noise, self.noise_blurred)
        )
        return slopes, instruments, noise_slopes, noise_instruments


@dataclass(frozen=True, eq=False)
class PairedRays:
    """Differences of opposite rays (pairs, chi), and their derivatives by the unknowns, (unknowns, pairs, chi).

    The unknowns are (u_c, tau, SDD), perhaps with others after them.

    Attributes
    ----------
    difference, slopes : float64
        Not blurred over chi, where white noise of the views is white.
    instruments : float64
        The slopes blurred twice over chi: the score is that of least squares of blurred differences.
    noise_slopes, noise_instruments : float64
        The same of half the differences, which carry as much noise as half the sums and no signal.
    used : bool
        Pairs of which both rays were measured.
    relative_residual : float
        RMS of the blurred differences against that of the blurred rays.
    derivatives : Derivatives
        What the slopes are made of.
    """

    difference: FloatArray
    slopes: FloatArray
    instruments: FloatArray
    noise_slopes: FloatArray
    noise_instruments: FloatArray
    used: NDArray[np.bool_]
    relative_residual: float
    derivatives: Derivatives

    def with_unknowns(self, derivatives: Derivatives, by_gamma: FloatArray, by_chi: FloatArray) -> "PairedRays":
        """With further unknowns, as of `Derivatives.slopes`."""
        slopes, instruments, noise_slopes, noise_instruments = derivatives.slopes(by_gamma, by_chi)
        return replace(
            self,
            slopes=np.concatenate([self.slopes, slopes]),
            instruments=np.concatenate([self.instruments, instruments]),
            noise_slopes=np.concatenate([self.noise_slopes, noise_slopes]),
            noise_instruments=np.concatenate([self.noise_instruments, noise_instruments]),
        )

    def scores(self) -> FloatArray:
        """Instruments times differences at each chi, (chi, unknowns)."""
        scores: FloatArray = np.einsum("xpt,pt->tx", self.instruments, self.difference)
        return scores

    def gram(self, *, corrected: bool) -> FloatArray:
        """(unknowns, unknowns) of instruments and slopes.

        Both are those of noisy data, and their noise makes the matrix too large (errors in variables); the noise's
        share, as half the differences have it, can be taken off.
        """
        gram = _products(self.instruments, self.slopes)
        return gram - _products(self.noise_instruments, self.noise_slopes) if corrected else gram

    def covariance(self, free: slice | list[int], *, corrected: bool, correlated: float = 0.0) -> FloatArray:
        """Heteroscedasticity-robust covariance (White 1980) of the free unknowns, from each chi's score.

        Scores within a share `correlated` of the turn count as correlated, with Bartlett's weights (Newey and West
        1987, Econometrica 55, 703). Infinite where the pairs do not show the unknowns.
        """
        gram, noisy = (self.gram(corrected=kind)[free][:, free] for kind in (corrected, False))
        if not (is_definite(noisy + noisy.T) and _signal_share(gram, noisy) > SIGNAL_SHARE):
            return np.full(gram.shape, math.inf)
        scores = self.scores()[:, free]
        bread = np.linalg.inv(gram)
        products, lags = scores.T @ scores, int(correlated * len(scores))
        for lag in range(1, lags + 1):
            shifted = scores.T @ np.roll(scores, lag, axis=0)
            products += (1.0 - lag / (lags + 1)) * (shifted + shifted.T)
        covariance: FloatArray = bread @ products @ bread.T
        return covariance


def fan_angles(scanner: Scanner, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each cell's fan angle (cells,) and the angle that the cell covers."""
    u_c, tau, sdd = vector
    w = cell_centres_mm(scanner) - u_c
    across, along = w * math.cos(tau), sdd + w * math.sin(tau)
    return np.arctan2(across, along), sdd * math.cos(tau) * scanner.detector_pitch_mm / (across**2 + along**2)


def is_definite(gram: FloatArray) -> bool:
    """Whether a matrix of products is positive definite beyond rounding, whatever the scale of its unknowns."""
    diagonal = np.diag(gram)
    if not np.all(diagonal > 0.0):
        return False
    scale = 1.0 / np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(gram * np.outer(scale, scale))[0] > 1e-6)


def _products(left: FloatArray, right: FloatArray) -> FloatArray:
    return left.reshape(len(left), -1) @ right.reshape(len(right), -1).T


def _signal_share(gram: FloatArray, noisy: FloatArray) -> float:
    """The smallest share that is left of the noisy matrix in any direction; a mask makes them a little asymmetric."""
    return float(eigh(gram + gram.T, noisy + noisy.T, eigvals_only=True)[0])
