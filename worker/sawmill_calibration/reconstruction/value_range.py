"""Range of a volume's values, from a sample of bounded size that is taken while the slices are written."""

import math

import numpy as np
from numpy.typing import NDArray

SAMPLED_VALUES = 4_000_000
PERCENTILES = (0.1, 97.0, 99.9)
# Metal is many times as dense as wood, and a nail that lies in a slice covers more than a thousandth of it. Knots are
# below this number of times the 97th percentile, which lies in the wood.
MOST_WOOD = 2.5


class ValueRange:
    """Percentiles of a volume (slice, x, y) that is never in memory as a whole.

    A picture in this range shows the wood, even if much of a slice is metal.

    Every pixel counts if the volume has at most `SAMPLED_VALUES` pixels; else every n-th along both sides of a slice.
    """

    def __init__(self, slices: int, size: int) -> None:
        self._step = max(1, math.ceil(math.sqrt(slices * size * size / SAMPLED_VALUES)))
        self._samples: list[NDArray[np.float32]] = []

    def sample(self, block: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the sampled values of some slices (slices, x, y)."""
        return block[:, :: self._step, :: self._step].ravel()

    def add(self, sample: NDArray[np.float32]) -> None:
        """Add a sample."""
        self._samples.append(sample)

    def percentiles(self) -> tuple[float, float]:
        """Return the 0.1 and the 99.9 percentile of the added samples, the second without metal."""
        low, wood, high = np.percentile(np.concatenate(self._samples), PERCENTILES)
        return float(low), float(min(high, MOST_WOOD * wood) if wood > 0.0 else high)
