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

    def sample(self, block: NDArray[np.float32]) -> NDArray[np.float32]:
        """The values to take of some slices (slices, x, y)."""
        return block[:, :: self._step, :: self._step].ravel()

    def add(self, sample: NDArray[np.float32]) -> None:
        """Take a sample."""
        self._samples.append(sample)

    def percentiles(self) -> tuple[float, float]:
        """The 0.1 and the 99.9 percentile of what was added."""
        low, high = np.percentile(np.concatenate(self._samples), PERCENTILES)
        return float(low), float(high)
