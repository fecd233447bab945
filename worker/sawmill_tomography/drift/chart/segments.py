"""Segments of a scanner's history: sums over groups of drift checks, and fits of a step and of a trend to them.

Every array may have leading axes, so that many scanners can be simulated at a time.

With x the mean until the candidate time, a step adds a constant (2,) afterwards and a trend a constant (2,) times the
days since. Both are generalised least squares fits with x unknown, so the error that all later drift checks share with
the baseline is in their covariances (Siegmund and Venkatraman 1995, Annals of Statistics 23, 255, for steps;
Xu, Wang and Reynolds 2013, Quality and Reliability Engineering International 29, 545, for trends).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from sawmill_tomography.drift.chart.looks import LookSpread, inverse, scaled, squared_length, times
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


# A trend lasts for at least this number of groups; a shorter change is a step, also one within a group.
FEWEST_OF_A_TREND = 8


@dataclass(frozen=True, eq=False)
class StepAndTrendFits:
    """Fits of one model of change, one for each candidate time, oldest first."""

    began_days: FloatArray  # (candidates, ...): the candidate times: ends of all segments but the newest
    change: FloatArray  # (candidates, ..., 2): the step, or the change a day
    covariance: FloatArray  # (candidates, ..., 2, 2)
    likelihood: FloatArray  # (candidates, ...)
    evidence: FloatArray  # (candidates, ...)

    @classmethod
    def of(
        cls, began: FloatArray, change: FloatArray, own: FloatArray, scatter: LookSpread, quiet: FloatArray
    ) -> "StepAndTrendFits":
        """Return the fits, given a change's covariance by the checks' own errors and by a quiet scanner's changes."""
        own = scaled(own, scatter.ratio)
        covariance = own + quiet
        distance = squared_length(change, inverse(covariance))
        return cls(began, change, covariance, squared_length(change, inverse(own)), scatter.chi_squared(distance))


def steps_and_trends(
    segments: Sequence[Segment], scatter: LookSpread, quiet: FloatArray
) -> tuple[StepAndTrendFits, StepAndTrendFits]:
    """Fit a step and a trend for each candidate time.

    `quiet` (2, 2): covariance of changes from one time to another that are not changes of the geometry.
    """
    now = segments[-1].last_days
    precision, weighted = moved(
        np.stack([segment.precision for segment in segments]),
        np.stack([segment.weighted for segment in segments]),
        np.stack([segment.first_days for segment in segments]) - now,
    )
    before, rest = np.cumsum(precision[:-1, ..., 0, :, :], axis=0), np.cumsum(precision[:0:-1], axis=0)[::-1]
    weighted_before = np.cumsum(weighted[:-1, ..., 0, :], axis=0)
    weighted_rest = np.cumsum(weighted[:0:-1], axis=0)[::-1]
    began = np.stack([segment.last_days for segment in segments[:-1]])

    before_covariance, after_covariance = inverse(before), inverse(rest[..., 0, :, :])
    step = times(after_covariance, weighted_rest[..., 0, :]) - times(before_covariance, weighted_before)
    steps = StepAndTrendFits.of(began, step, before_covariance + after_covariance, scatter, quiet)

    span = now - began
    ago = span[..., None, None]
    plain, once, twice = (rest[..., k, :, :] for k in range(3))
    # Normal equations of mean and slope, with times from the candidate; the mean is eliminated.
    along = once + ago * plain
    square = twice + 2.0 * ago * once + ago**2 * plain
    right = weighted_rest[..., 1, :] + span[..., None] * weighted_rest[..., 0, :]
    every = inverse(before[-1] + rest[-1, ..., 0, :, :])
    mean = times(every, weighted_before[-1] + weighted_rest[-1, ..., 0, :])
    slope_covariance = inverse(square - along @ every @ along)
    slope = times(slope_covariance, right - times(along, mean))
    over_span = np.divide(1.0, ago**2, out=np.zeros_like(ago), where=ago > 0.0)
    slope[np.cumsum([segment.groups for segment in segments[:0:-1]])[::-1] < FEWEST_OF_A_TREND] = 0.0
    return steps, StepAndTrendFits.of(began, slope, slope_covariance, scatter, quiet * over_span)
