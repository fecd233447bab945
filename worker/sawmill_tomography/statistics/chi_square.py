"""The upper tail of the chi-square distribution, without `scipy.special`, whose import would delay each start."""

import math

CONVERGED = 1e-14


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
