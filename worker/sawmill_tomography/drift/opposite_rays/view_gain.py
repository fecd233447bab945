"""Gain and offset of each view, from opposite rays: a source or flat field that drifts from view to view."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from sawmill_tomography.geometry.geometry import FloatArray

# Opposite rays are compared on samples this many cells apart, each a Gaussian mean this wide: nearly independent.
SPACING_CELLS, WIDTH_CELLS = 5.0, 1.5
# Weights of cells farther away are below 1e-15.
REACH_CELLS = 13
# Each round removes half of the residual: the opposite rays contain as much of it as the rays.
ROUNDS = 8
# Gain and offset of the views must explain this number of times more of the differences than noise would
# (benchmarks/unsteady.py at 3ab7f653).
EVIDENCE = 3.0


@dataclass(frozen=True, eq=False)
class ViewGain:
    """Gain of each view, (views,), mean 1, and the offset added after the gain, (views,), mean 0."""

    gain: FloatArray
    offset: FloatArray

    @property
    def done(self) -> str:
        """The correction, in one sentence for people."""
        return f"the views' gain scattered by {np.std(self.gain):.2%} and was evened out"

    def removed(self, sinogram: FloatArray) -> FloatArray:
        """Return the sinogram (views, cells) without gain and offset."""
        corrected: FloatArray = (sinogram - self.offset[:, None]) / self.gain[:, None]
        return corrected


def view_gain(sinogram: FloatArray, fan_rad: FloatArray, *, reversed_turn: bool) -> ViewGain | None:
    """Fit each view's gain and offset by p(phi, gamma) = p(phi + pi - 2 gamma, -gamma); None where noise explains them.

    A gain that varies with an even harmonic of the turn is the same in opposite views and stays.

    `sinogram` (views, cells): line integrals at equidistant angles over the full turn. `fan_rad` (cells,): fan angle of
    each cell, ascending through zero.
    """
    gamma, means = _means(fan_rad)
    rays = means @ np.ascontiguousarray(sinogram.T)
    views = len(sinogram)
    shift = (math.pi - 2.0 * gamma) * (-1.0 if reversed_turn else 1.0)
    phase = np.exp(1j * np.outer(shift, np.arange(views // 2 + 1)))
    estimate = ViewGain(np.ones(views), np.zeros(views))
    for done in range(ROUNDS):
        corrected = rays - estimate.offset
        corrected /= estimate.gain
        opposite = scipy.fft.irfft(scipy.fft.rfft(corrected)[::-1] * phase, views)
        gain, offset = _line(opposite, corrected)
        if done == 0 and _evidence(opposite, corrected, gain, offset) < EVIDENCE:
            return None
        gain = 1.0 + 0.5 * (gain - gain.mean())
        offset = 0.5 * (offset - offset.mean())
        estimate = ViewGain(estimate.gain * gain, estimate.offset + estimate.gain * offset)
    return estimate


def _means(fan_rad: FloatArray) -> tuple[FloatArray, "scipy.sparse.csr_array"]:
    """Return fan angles symmetric about zero, (samples,), and the weights of their means, (samples, cells)."""
    spacing = float(np.median(np.diff(fan_rad)))
    count = int(min(-fan_rad[0], fan_rad[-1]) / (SPACING_CELLS * spacing))
    half = (np.arange(count) + 0.5) * SPACING_CELLS * spacing
    gamma = np.concatenate([-half[::-1], half])
    near = np.searchsorted(fan_rad, gamma)[:, None] + np.arange(-REACH_CELLS, REACH_CELLS)
    inside = (near >= 0) & (near < fan_rad.size)
    near = near.clip(0, fan_rad.size - 1)
    weights = inside * np.exp(-0.5 * ((fan_rad[near] - gamma[:, None]) / (WIDTH_CELLS * spacing)) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    borders = np.arange(gamma.size + 1) * near.shape[1]
    return gamma, scipy.sparse.csr_array((weights.ravel(), near.ravel(), borders), shape=(gamma.size, fan_rad.size))


def _line(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return slope and intercept of y over x (samples, views) in each view."""
    x_mean, y_mean = x.mean(axis=0), y.mean(axis=0)
    x = x - x_mean
    slope = np.einsum("sv,sv->v", x, y) / np.einsum("sv,sv->v", x, x)
    return slope, y_mean - slope * x_mean


def _evidence(x: FloatArray, y: FloatArray, slope: FloatArray, intercept: FloatArray) -> float:
    """Return the sum of squares that the lines explain beyond y = x.

    The sum is divided by the two unknowns, in units of the residual for each degree of freedom.
    """
    residual = float(np.sum((y - slope * x - intercept) ** 2))
    explained = float(np.sum((y - x) ** 2)) - residual
    freedom = (len(x) - 2) / 2
    return explained / residual * freedom
