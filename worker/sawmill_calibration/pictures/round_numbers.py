"""Round numbers for axes and scale bars, without NumPy, because an idle service draws its charts with this module."""

import math


def round_length(longest: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `longest`."""
    power = 10.0 ** math.floor(math.log10(longest))
    return next(digit * power for digit in (5, 2, 1) if digit * power <= longest * (1 + 1e-9))


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Return at most `most` round values inside a range."""
    step = round_length((high - low) / most)
    while math.floor(high / step) - math.ceil(low / step) + 1 > most:
        step = round_length(step * 2.5)
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
