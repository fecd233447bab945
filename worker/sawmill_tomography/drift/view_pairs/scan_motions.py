"""Motions that disturb a scan: wrong angles, an axis that wobbles, and a log or an axis that slides.

A motion is linear in its amplitude: each view's angle error, and the displacement of the log across and along the beam.
How large the motions are is estimated from the differences of the views themselves (`motion_sizes`), so that a scanner
that keeps still loses nothing to them.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

# RMS amplitude of the angles' error once a turn: an eccentric encoder.
ENCODER_DEG = 0.1
# Standard deviations of the largest motions: the turn's error over the scan, the axis's amplitudes once and twice a
# turn, and the way that log or axis slides.
TURN_DEG, WOBBLE_MM, SLIDE_MM = 3.0, 0.2, 0.5
# Sizes of each kind of motion that are compared, as shares of the largest, and their probabilities before a scan: 1 / s
# as in the tail of a half-Cauchy distribution (Gelman 2006, Bayesian Analysis 1, 515), and so large together that the
# RMS is a sound scanner's, 0.02 mm of wobble.
SIZES = np.array([0.0, 0.03, 0.1, 0.3, 1.0])
PROBABILITIES = np.append(0.7, 0.3 / SIZES[1:] / np.sum(1.0 / SIZES[1:]))
# Motions are named if they are this number of times as likely as none, as a natural logarithm.
FOUND = 8.0


class MotionSizes(NamedTuple):
    """Estimated standard deviations of motions, and whether there are any."""

    shares: FloatArray  # (motions,): standard deviations as shares of the largest
    found: bool  # True if motions are far more likely than none


class ScanMotions(NamedTuple):
    """Motions, each with an amplitude of one of its largest standard deviations."""

    turned_rad: FloatArray  # (views, motions): turn of the log beyond the stated angles
    moved_mm: FloatArray  # (2, views, motions)
    kinds: tuple[str, ...]  # the kind of each motion; motions of a kind have one size

    def described(self, amplitudes: FloatArray) -> str:
        """Return how far the log moved with these amplitudes, (motions,), and what to check, in one sentence."""
        moved_mm = float(np.hypot(*(self.moved_mm @ amplitudes)).max())
        wrong_deg = math.degrees(float(np.abs(self.turned_rad @ amplitudes).max()))
        return (
            f"during the scan the log moved by up to {moved_mm:.2g} mm and its angles went wrong by up to "
            f"{wrong_deg:.2g} degrees, which was fitted: check the turntable's bearing, the clamps and the angles"
        )

    @property
    def turns(self) -> NDArray[np.bool_]:
        """True for motions that turn the log, (motions,)."""
        turns: NDArray[np.bool_] = np.any(self.turned_rad != 0.0, axis=0)
        return turns

    @classmethod
    def encoder(cls, angles_rad: FloatArray) -> "ScanMotions":
        """Return the angles' error once a turn by `ENCODER_DEG`, as cosine and sine."""
        turned = math.radians(ENCODER_DEG) * _waves(angles_rad, 1)
        return cls(turned, np.zeros((2, *turned.shape)), ("encoder", "encoder"))

    @classmethod
    def of_scan(cls, angles_rad: FloatArray, times: FloatArray) -> "ScanMotions":
        """Return the motions of views (views,) taken at these times, from -0.5 to 0.5 over the scan.

        A slide is of the log, in two directions that turn with it, or of the axis, across and along the beam.
        """
        time = times[:, None]
        turn = math.radians(TURN_DEG) * time
        waves = np.hstack([_waves(angles_rad, order) for order in (1, 2)])
        wobble: FloatArray = WOBBLE_MM * np.stack([np.hstack([waves, 0.0 * waves]), np.hstack([0.0 * waves, waves])])
        with_log, still = time * _waves(angles_rad, 1), 0.0 * time
        across, along = np.hstack([with_log, time, still]), np.hstack([with_log[:, ::-1] * [-1.0, 1.0], still, time])
        moved = np.concatenate([np.zeros((2, *turn.shape)), wobble, SLIDE_MM * np.stack([across, along])], axis=2)
        kinds = ("turn",) + ("wobble",) * wobble.shape[2] + ("slide",) * across.shape[1]
        return cls(np.pad(turn, ((0, 0), (0, len(kinds) - 1))), moved, kinds)


def _waves(angles_rad: FloatArray, order: int) -> FloatArray:
    """Return cosine and sine, (views, 2)."""
    waves: FloatArray = np.stack([np.cos(order * angles_rad), np.sin(order * angles_rad)], axis=1)
    return waves


def motion_sizes(residual: FloatArray, known: FloatArray, motions: FloatArray, kinds: tuple[str, ...]) -> MotionSizes:
    """Estimate the motions' sizes from whitened differences by their restricted likelihood.

    Every combination of sizes counts with its likelihood (Harville 1977, Journal of the American Statistical
    Association 72, 320), the noise's variance being unknown: uncertain sizes enlarge the covariance.

    `residual` (differences,). `known` (differences, columns): orthonormal columns that explain anything: the geometry's
    slopes and the views' gains. `motions` (differences, motions): change of the differences by the motions.
    """
    names = list(dict.fromkeys(kinds))
    residual, motions = residual - known @ (known.T @ residual), motions - known @ (known.T @ motions)
    free = len(residual) - known.shape[1]
    levels = np.array(list(product(range(SIZES.size), repeat=len(names))))
    shares = SIZES[levels][:, [names.index(kind) for kind in kinds]]
    gram = np.eye(len(kinds)) + shares[:, :, None] * (motions.T @ motions) * shares[:, None, :]
    right = shares * (motions.T @ residual)
    explained = np.einsum("hm,hm->h", right, np.linalg.solve(gram, right[..., None])[..., 0])
    left = np.maximum(float(residual @ residual) - explained, np.finfo(float).tiny)
    likelihoods = -0.5 * np.linalg.slogdet(gram)[1] - 0.5 * free * np.log(left)
    # The first combination is no motion at all.
    weights = PROBABILITIES[levels].prod(axis=1) * np.exp(likelihoods - likelihoods.max())
    weights /= weights.sum()
    found = bool(likelihoods.max() - likelihoods[0] > FOUND)
    return MotionSizes(np.sqrt(weights @ shares**2), found)
