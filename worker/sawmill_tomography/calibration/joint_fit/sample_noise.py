"""The noise of samples: variances and weights."""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics import DEVIATION_OF_MEDIAN

# Number of levels of the model, in each of which noise is alike, and number of samples enough to measure a level's
# noise, where a scan has that many for each.
LEVELS, ENOUGH = 8, 50
# Noise is measured on about MEASURED samples. A variance counts as at least the share LEAST_NOISE of the mean: air may
# be free of noise.
MEASURED, LEAST_NOISE = 20_000, 0.05


@dataclass(frozen=True, eq=False)
class SampleNoise:
    """The noise of each sample."""

    variance: FloatArray  # (views, cells): variance of the noise; 0 everywhere for an exact scan
    weights: FloatArray  # (views, cells): the data's weights divided by the variance


def sample_noise(data: SinogramData, residual: FloatArray, model: FloatArray) -> SampleNoise:
    """Estimate the noise, which depends on the line integral as photon noise does.

    Neighbouring cells do not share noise, but share the model's errors: noise is measured on differences of neighbours.
    """
    low, high = float(model.min()), float(model.max())
    per_level = LEVELS * (1.0 - 1e-9) / max(high - low, np.finfo(np.float64).tiny)
    views = slice(None, None, max(1, residual.size // MEASURED))
    steps, values = np.abs(np.diff(residual[views], axis=1)), model[views, 1:]
    at = ((values - low) * per_level).astype(np.uint8)
    level_means, variance, counts = [], [], []
    for one in range(LEVELS):
        here = (at == one) & (steps > 0.0)
        if np.count_nonzero(here) >= min(ENOUGH, max(1, int(np.count_nonzero(steps)) // LEVELS)):
            level_means.append(float(values[here].mean()))
            variance.append(0.5 * (DEVIATION_OF_MEDIAN * float(np.median(steps[here]))) ** 2)
            counts.append(np.count_nonzero(here))
    if not level_means:  # an exact scan has no noise
        weights = np.ones_like(residual) if data.weights is None else data.weights
        return SampleNoise(np.zeros_like(residual), weights)
    of_sample = np.interp(model, level_means, _smooth(np.array(level_means), np.log(variance), np.array(counts)))
    np.exp(of_sample, out=of_sample)
    weights = np.maximum(of_sample, LEAST_NOISE * float(of_sample.mean()))
    np.divide(1.0, weights, out=weights)
    if data.weights is not None:
        weights *= data.weights
    weights *= np.count_nonzero(weights) / weights.sum()
    return SampleNoise(of_sample, weights)


def _smooth(means: FloatArray, logs: FloatArray, counts: FloatArray) -> FloatArray:
    """Return the logarithms (levels,) of variances, drawn to a straight line of the line integral.

    They keep what they scatter more than their errors. For photons the line's slope is 1, and less where the
    electronics add noise.
    """
    if len(means) < 3:
        return logs
    # The logarithm of twice the square of a median of n differences has about this standard deviation.
    errors = 2.0 / np.sqrt(counts)
    line = np.polyval(np.polyfit(means, logs, 1, w=1.0 / errors), means)
    excess = max(float(((logs - line) ** 2 - errors**2).mean()), 0.0)
    return np.asarray(line + (logs - line) * excess / (excess + errors**2))
