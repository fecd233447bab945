"""Each view's gain and offset, found from opposite rays: a source or flat field that drifts from view to view."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft

from sawmill_worker.tomography.geometry import FloatArray

# Opposite rays are compared on samples this many cells apart, each a Gaussian mean this wide: nearly independent.
SPACING_CELLS, WIDTH_CELLS = 5.0, 1.5
# Each round takes half of the residual: the opposite rays have as much of it as the rays.
ROUNDS = 8
# Gain and offset of the views must explain this number of times more of the differences than noise would
# (benchmarks/unsteady.py).
EVIDENCE = 3.0


@dataclass(frozen=True, eq=False)
class ViewGain:
    """Each view's gain, (views,), mean 1, and the offset added after it, (views,), mean 0."""

    gain: FloatArray
    offset: FloatArray

    @property
    def done(self) -> str:
        """One sentence."""
        return f"the views' gain scattered by {np.std(self.gain):.2%} and was evened out"

    def removed(self, sinogram: FloatArray) -> FloatArray:
        """The sinogram (views, cells) without gain and offset."""
        corrected: FloatArray = (sinogram - self.offset[:, None]) / self.gain[:, None]
        return corrected


def view_gain(sinogram: FloatArray, fan_rad: FloatArray, *, reversed_turn: bool) -> ViewGain | None:
    """Gain and offset of each view from p(phi, gamma) = p(phi + pi - 2 gamma, -gamma); None where noise explains them.

    What turns twice or an even number of times with the log is the same in opposite views and stays.

    Parameters
    ----------
    sinogram : (views, cells) float64
        At equidistant angles all round.
    fan_rad : (cells,) float64
        Fan angle of each cell, ascending through zero.
    """
    gamma, means = _means(fan_rad)
    rays = sinogram @ means
    shift = (math.pi - 2.0 * gamma) * (-1.0 if reversed_turn else 1.0)
    phase = np.exp(1j * np.outer(np.arange(len(rays) // 2 + 1), shift))
    found = ViewGain(np.ones(len(rays)), np.zeros(len(rays)))
    for done in range(ROUNDS):
        corrected = found.removed(rays)
        opposite = irfft(rfft(corrected[:, ::-1], axis=0) * phase, len(rays), axis=0)
        gain, offset, evidence = _line(opposite, corrected)
        if done == 0 and evidence < EVIDENCE:
            return None
        gain = 1.0 + 0.5 * (gain - gain.mean())
        offset = 0.5 * (offset - offset.mean())
        found = ViewGain(found.gain * gain, found.offset + found.gain * offset)
    return found


def _means(fan_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fan angles that lie symmetrically about zero, (samples,), and the weights of their means, (cells, samples)."""
    spacing = float(np.median(np.diff(fan_rad)))
    count = int(min(-fan_rad[0], fan_rad[-1]) / (SPACING_CELLS * spacing))
    half = (np.arange(count) + 0.5) * SPACING_CELLS * spacing
    gamma = np.concatenate([-half[::-1], half])
    weights = np.exp(-0.5 * ((fan_rad[:, None] - gamma) / (WIDTH_CELLS * spacing)) ** 2)
    return gamma, weights / weights.sum(axis=0)


def _line(x: NDArray[np.float64], y: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Slope and intercept of y over x in each view, and the sum of squares that they explain beyond y = x.

    The sum is given for each of the two unknowns, in units of the residual for each degree of freedom.
    """
    x_mean, y_mean = x.mean(axis=1, keepdims=True), y.mean(axis=1, keepdims=True)
    spread = np.sum((x - x_mean) ** 2, axis=1)
    slope = np.sum((x - x_mean) * (y - y_mean), axis=1) / spread
    intercept = (y_mean - slope[:, None] * x_mean)[:, 0]
    residual = float(np.sum((y - slope[:, None] * x - intercept[:, None]) ** 2))
    explained = float(np.sum((y - x) ** 2)) - residual
    freedom = (x.shape[1] - 2) / 2
    return slope, intercept, explained / residual * freedom
