"""Robust statistics: what a few outliers do not change."""

import math

import numpy as np
from numpy.typing import NDArray

# The standard deviation of a normal distribution over its median absolute deviation: 1 / Phi^-1(3/4).
DEVIATION_OF_MEDIAN = 1.4826


def robust_deviation(departures: NDArray[np.floating]) -> float:
    """The standard deviation of normal values from their departures (any shape) from the middle, by the median."""
    return DEVIATION_OF_MEDIAN * float(np.median(np.abs(departures)))


def noise_of_differences(differences: NDArray[np.floating], order: int) -> float:
    """The standard deviation of white noise from differences of neighbouring samples, by their median.

    Parameters
    ----------
    differences : any shape
        Of the first order see no constant, of the second order no slope either.
    order : int
        The variance of a difference is (2 order)! / (order!)^2 times that of a sample: 2, 6, 20.
    """
    return robust_deviation(differences) / math.sqrt(math.comb(2 * order, order))
