"""Segments of a scanner's history: sums over groups of drift checks, from which steps and trends are fitted.

Every array may have leading axes, so that many scanners can be simulated at a time.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from sawmill_tomography.drift.chart.spread import times
from sawmill_tomography.geometry.geometry import FloatArray

# Segments of each size, in groups: 1, 2, 4 and so on. A change point is at most 1/16 of its age away from a segment's
# end. A step fitted at this distance leaves a smaller residual than a trend, which leaves 1/9 of what it explains.
OF_EACH_SIZE = 8


@dataclass(frozen=True, eq=False)
class Segment:
    """Sums over groups of drift checks that follow each other, with P a group's precision, y its mean, t its days."""

    groups: int
    first_days: FloatArray  # time of the first and of the last group
    last_days: FloatArray
    precision: FloatArray  # (..., 3, 2, 2): sums of P, P (t - first_days) and P (t - first_days)^2
    weighted: FloatArray  # (..., 2, 2): sums of P y and P y (t - first_days)

    @classmethod
    def of_group(cls, days: FloatArray, mean: FloatArray, precision: FloatArray) -> Self:
        """Return the segment of one group: its time (...), mean (..., 2) and precision (..., 2, 2)."""
        zero = np.zeros_like(precision)
        weighted = times(precision, mean)
        return cls(
            1,
            np.asarray(days, np.float64),
            np.asarray(days, np.float64),
            np.stack([precision, zero, zero], axis=-3),
            np.stack([weighted, np.zeros_like(weighted)], axis=-2),
        )

    def joined(self, later: "Segment") -> "Segment":
        """Return this segment and a later one as one segment."""
        precision, weighted = moved(later.precision, later.weighted, later.first_days - self.first_days)
        return Segment(
            self.groups + later.groups,
            self.first_days,
            later.last_days,
            self.precision + precision,
            self.weighted + weighted,
        )


def moved(precision: FloatArray, weighted: FloatArray, later_days: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a segment's sums with times counted from `later_days` (...) earlier."""
    later = later_days[..., None, None]
    plain, once, twice = (precision[..., k, :, :] for k in range(3))
    values, sloping = weighted[..., 0, :], weighted[..., 1, :]
    return (
        np.stack([plain, once + later * plain, twice + 2.0 * later * once + later**2 * plain], axis=-3),
        np.stack([values, sloping + later[..., 0] * values], axis=-2),
    )


def extended(segments: Iterable[Segment], newest: Segment) -> tuple[Segment, ...]:
    """Add a group to the segments, oldest first; join the oldest two of more than `OF_EACH_SIZE` of a size.

    So the number of segments grows with the logarithm of the number of groups: the exponential histogram of Datar,
    Gionis, Indyk and Motwani (2002, SIAM Journal on Computing 31, 1794).
    """
    kept, size = [*segments, newest], newest.groups
    while sum(segment.groups == size for segment in kept) > OF_EACH_SIZE:
        oldest = next(at for at, segment in enumerate(kept) if segment.groups == size)
        kept[oldest : oldest + 2] = [kept[oldest].joined(kept[oldest + 1])]
        size *= 2
    return tuple(kept)
