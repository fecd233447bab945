"""The size of a jump from looks that are certainly before or after it.

The likeliest time of a jump is the end of a group or a segment, but scanners move in the midst of one. So neither side
of that time counts for the size: later groups are compared with earlier ones. While there is only one group after it,
its looks are compared singly with all that was before, and each of them may be the first after the jump.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sawmill_tomography.drift.chart.looks import FEWEST_BASELINE_LOOKS, OUTLYING, Look, pooled_means, stacked
from sawmill_tomography.drift.chart.matrices import inverse, scaled, squared_length, times
from sawmill_tomography.drift.chart.scatter import Scatter
from sawmill_tomography.drift.chart.segments import Segment
from sawmill_tomography.geometry.geometry import FloatArray


class Jump(NamedTuple):
    """A jump's size (2,) with its covariance (2, 2), and the number of the newest looks that were before it."""

    change: FloatArray
    covariance: FloatArray
    looks_before: int


def jump_at(
    began_days: float, segments: Sequence[Segment], newest: Sequence[Look], scatter: Scatter, quiet: FloatArray
) -> Jump:
    """The jump of one scanner at the end of a segment or soon after.

    Parameters
    ----------
    began_days : float
        The last time of the segment.
    segments : of ()
        Oldest first, at least one later than that.
    newest : sequence of Look
        What the newest group was pooled from.
    scatter, quiet
        As in `steps_and_trends`.
    """
    earlier = [segment for segment in segments if segment.last_days <= began_days]
    later = segments[len(earlier) :]
    mean, covariance = _mean(earlier[:-1] or earlier)
    if len(later) == 1:
        return _within(newest, mean, covariance, scatter, quiet)
    mean_later, covariance_later = _mean(later[1:])
    return Jump(mean_later - mean, scaled(covariance + covariance_later, scatter.ratio) + quiet, 0)


def _within(
    looks: Sequence[Look], mean: FloatArray, covariance: FloatArray, scatter: Scatter, quiet: FloatArray
) -> Jump:
    """With each look as the first one after it, by the likelihood of all: outliers count as what is `OUTLYING`."""
    change, own = stacked(looks)
    precision = inverse(scaled(own, scatter.ratio))
    before = _bounded(change - mean, precision)
    unlikely, sizes, errors = [], [], []
    for first in range(len(looks) - FEWEST_BASELINE_LOOKS + 1):
        after = pooled_means(change[first:], own[first:])
        unlikely.append(before[:first].sum() + _bounded(change[first:] - after.mean, precision[first:]).sum())
        sizes.append(after.mean - mean)
        errors.append(scaled(inverse(after.precision) + covariance, scatter.ratio) + quiet)
    weights = np.exp(-0.5 * (np.array(unlikely) - min(unlikely)))
    weights /= weights.sum()
    size = weights @ np.stack(sizes)
    apart = np.stack(sizes) - size
    spread = np.einsum("k,kij->ij", weights, np.stack(errors) + apart[:, :, None] * apart[:, None, :])
    return Jump(size, spread, int(np.argmin(unlikely)))


def _mean(segments: Sequence[Segment]) -> tuple[FloatArray, FloatArray]:
    """Of their groups, with its covariance by the looks' own ones."""
    covariance = inverse(np.sum([segment.precision[0] for segment in segments], axis=0))
    return times(covariance, np.sum([segment.weighted[0] for segment in segments], axis=0)), covariance


def _bounded(apart: FloatArray, precision: FloatArray) -> FloatArray:
    """Chi-squared of each look, that of an outlier bounded."""
    bounded: FloatArray = np.minimum(squared_length(apart, precision), OUTLYING**2)
    return bounded
