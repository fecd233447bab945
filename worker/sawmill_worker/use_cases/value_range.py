"""The range of a volume's values, from a sample of bounded size taken while its slices go by."""

import math

import numpy as np
from numpy.typing import NDArray

SAMPLED_VALUES = 4_000_000
PERCENTILES = (0.1, 99.9)


class ValueRange:
    """Percentiles of a volume (slice, x, y) that is never in memory as a whole.

    Every pixel counts where the volume has at most `SAMPLED_VALUES`; else every n-th along either side of a slice.
    """

    def __init__(self, slices: int, size: int) -> None:
        self._step = max(1, math.ceil(math.sqrt(slices * size * size / SAMPLED_VALUES)))
        self._samples: list[NDArray[np.float32]] = []

    def add(self, block: NDArray[np.float32]) -> None:
        """Take the sample of some slices (slices, x, y)."""
        self._samples.append(block[:, :: self._step, :: self._step].ravel())

    def percentiles(self) -> tuple[float, float]:
        """The 0.1 and the 99.9 percentile of what was added."""
        low, high = np.percentile(np.concatenate(self._samples), PERCENTILES)
        return float(low), float(high)
