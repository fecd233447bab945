"""Robust statistics, which a few outliers do not change."""

import math

import numpy as np
from numpy.typing import NDArray

# The standard deviation of a normal distribution over its median absolute deviation: 1 / Phi^-1(3/4).
DEVIATION_OF_MEDIAN = 1.4826


def robust_deviation(departures: NDArray[np.floating]) -> float:
    """Return the standard deviation of normal values from their departures (any shape) from the centre, by median."""
    return DEVIATION_OF_MEDIAN * float(np.median(np.abs(departures)))


def noise_of_differences(differences: NDArray[np.floating], order: int) -> float:
    """Return the standard deviation of white noise from differences of neighbouring samples, by their median."""
    return robust_deviation(differences) / math.sqrt(math.comb(2 * order, order))
