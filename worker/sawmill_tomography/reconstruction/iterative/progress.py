"""Progress of a method: a share of the whole that only rises."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from sawmill_tomography.reconstruction.iterative.descent import OnIteration

# Called with the finished share of the work, from 0 to 1.
OnProgress = Callable[[float], None]

# The cost of each further image relative to the first, measured on 16 of 256 x 256 pixels
# (benchmarks/iterative.py at 3ab7f653).
FURTHER_IMAGE_COST = 0.6


def part_of(on_progress: OnProgress | None, start: float, length: float) -> OnProgress:
    """Return a callback for the share of a part that starts at `start` of the whole and is `length` of the whole."""

    def report(share: float) -> None:
        if on_progress is not None:
            on_progress(min(start + length * share, 1.0))

    return report


class Phases:
    """The phases of one piece of work, in their order.

    Parameters
    ----------
    on_progress : callable or None
        Called with the share of the whole.
    costs
        Cost of each phase, in any common unit.
    """

    def __init__(self, on_progress: OnProgress | None, **costs: float) -> None:
        ends = np.cumsum([0.0, *costs.values()]) / math.fsum(costs.values())
        self._on_share = on_progress
        self._parts = {
            name: (float(start), float(end - start)) for name, (start, end) in zip(costs, pairwise(ends), strict=True)
        }

    def of(self, phase: str) -> OnProgress:
        """Return a callback for the share of one phase."""
        return part_of(self._on_share, *self._parts[phase])

    def descent(self, phase: str, usual: int) -> OnIteration:
        """Return a callback for the iterations of one phase, which mostly ends after the usual number of iterations."""
        return counting_iterations(self.of(phase), usual)


def counting_iterations(on_progress: OnProgress, usual: int) -> OnIteration:
    """Return a callback for the iterations of a descent of unknown length, which mostly ends after the usual number.

    The remaining iterations are predicted as the usual number at first and as fewer and fewer later, since a descent
    that takes longer mostly ends soon; never as more than are allowed. The share rises with every iteration.
    """

    def report(done: int, most: int) -> None:
        remaining = min(usual * math.exp(-done / usual), float(most - done))
        on_progress(done / (done + remaining))

    return report


def cost_of_images(images: int) -> float:
    """Return the cost of a block relative to one image: the images of a block share the lengths of the rays."""
    return 1.0 + FURTHER_IMAGE_COST * (images - 1)
