"""Statistics without `scipy.special`, whose import would delay each start: of chance, and robust ones."""

import math

import numpy as np
from numpy.typing import NDArray

CONVERGED = 1e-14
# 95 % of a normal distribution lie within this number of standard deviations of the mean.
TWO_SIDED_95 = 1.96
# The standard deviation of a normal distribution over its median absolute deviation: 1 / Phi^-1(3/4).
DEVIATION_OF_MEDIAN = 1.4826


def exceeded_chi_square(probability: float, degrees: float) -> float:
    """Compute the chi-square that chance exceeds with this probability, which is at most one half.

    Newton's method on log Q(a, x) (DLMF 8.2.4), with a half of the degrees of freedom and x half of the chi-square.
    Beyond its first step it comes from one side, since log Q is concave for a of at least 1 and convex below.
    """
    a = x = 0.5 * degrees
    target = math.log(probability) + math.lgamma(a)
    step = math.inf
    # The step after the last would be about its square.
    while abs(step) >= 1e-8 * x:
        ratio = _tail_ratio(a, x)
        step = (a * math.log(x) - x + math.log(ratio) - target) * x * ratio
        x += step
    return 2.0 * x


def _tail_ratio(a: float, x: float) -> float:
    """Compute Q(a, x) Gamma(a) exp(x) / x^a by its continued fraction (DLMF 8.9.2) as Lentz evaluates it."""
    partial = x + 1.0 - a
    before, reciprocal = math.inf, 1.0 / partial
    value = reciprocal
    change, term = math.inf, 0
    while abs(change - 1.0) >= CONVERGED:
        term += 1
        numerator = term * (a - term)
        partial += 2.0
        reciprocal = 1.0 / (numerator * reciprocal + partial)
        before = partial + numerator / before
        change = before * reciprocal
        value *= change
    return value


def robust_deviation(departures: NDArray[np.floating]) -> float:
    """Return the standard deviation of normal values from their departures (any shape) from the centre, by median."""
    return DEVIATION_OF_MEDIAN * float(np.median(np.abs(departures)))


def few_with_most(power: NDArray[np.floating], share: float, times: float = 0.0) -> NDArray[np.intp]:
    """Return which few of these values (n,) hold more than half of their sum, in rising order; none where no few do.

    Few are at most a `share` of the values, each above `times` the median.
    """
    largest = np.sort(np.argsort(power)[::-1][: max(1, round(share * power.size))])
    if times:
        largest = largest[power[largest] > times * max(np.median(power), power.max() / times**2)]
    return largest if power[largest].sum() > 0.5 * power.sum() else largest[:0]


def noise_of_differences(differences: NDArray[np.floating], order: int) -> float:
    """Return the standard deviation of white noise from differences of neighbouring samples, by their median."""
    return robust_deviation(differences) / math.sqrt(math.comb(2 * order, order))
