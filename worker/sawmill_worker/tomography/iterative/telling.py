"""How far a method has come, told as a share of the whole that only rises."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from sawmill_worker.tomography.iterative.descent import Progress

# Told the share of the whole that is done, from 0 to 1.
Told = Callable[[float], None]

# What each further image costs of the first, measured on 16 of 256 x 256 pixels.
SIDE_BY_SIDE = 0.6


def part_of(told: Told | None, start: float, length: float) -> Told:
    """To be told the share of a part, which begins and is as long as said, of what is told; by None nobody is."""

    def tell(share: float) -> None:
        if told is not None:
            told(min(start + length * share, 1.0))

    return tell


class Phases:
    """The phases of one piece of work, in their order.

    Parameters
    ----------
    told : callable or None
        Told the share of the whole.
    costs
        Of each phase, in any unit that they have in common.
    """

    def __init__(self, told: Told | None, **costs: float) -> None:
        ends = np.cumsum([0.0, *costs.values()]) / math.fsum(costs.values())
        self._told = told
        self._parts = {
            name: (float(start), float(end - start)) for name, (start, end) in zip(costs, pairwise(ends), strict=True)
        }

    def of(self, phase: str) -> Told:
        """To be told the share of one phase."""
        return part_of(self._told, *self._parts[phase])

    def descent(self, phase: str, usual: int) -> Progress:
        """To be told the iterations of one phase, which mostly ends after the usual number of them."""
        return descending(self.of(phase), usual)


def descending(tell: Told, usual: int) -> Progress:
    """To be told the iterations of a descent, which mostly ends after the usual number of them, as a share of it."""
    return lambda done, most: tell(share_of_descent(done, most, usual))


def side_by_side(images: int) -> float:
    """What so many images cost side by side, one alone being 1: they share the rays' lengths."""
    return 1.0 + SIDE_BY_SIDE * (images - 1)


def share_of_descent(done: int, most: int, usual: int) -> float:
    """The share of a descent that `done` iterations are, when it will end nobody knows.

    What is left is foretold as the usual number at first and as less and less of it, for one that takes longer mostly
    ends soon; and never as more than may be done. The share rises with every iteration.
    """
    left = min(usual * math.exp(-done / usual), float(most - done))
    return done / (done + left)
