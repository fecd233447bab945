"""The size of a jump from drift checks that are certainly before or after the jump.

The likeliest time of a jump is the end of a group or a segment, but scanners move within a group. So neither side
of that time counts for the size: later groups are compared with earlier ones. While there is only one group after the
jump, its drift checks are compared one by one with all groups before, and each of them may be the first after the jump.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sawmill_tomography.drift.chart.looks import FEWEST_BASELINE_LOOKS, OUTLYING, DriftCheckPoint, pooled_means, stacked
from sawmill_tomography.drift.chart.segments import Segment
from sawmill_tomography.drift.chart.spread import LookSpread, inverse, scaled, squared_length, times
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DetectorEstimate


class Jump(NamedTuple):
    """Size of a jump, and the number of the newest drift checks before the jump."""

    change: DetectorEstimate
    looks_before: int


def jump_at(
    began_days: float,
    segments: Sequence[Segment],
    newest: Sequence[DriftCheckPoint],
    scatter: LookSpread,
    quiet: FloatArray,
) -> Jump:
    """Measure the jump of one scanner at the end of a segment or soon after."""
    earlier = [segment for segment in segments if segment.last_days <= began_days]
    later = segments[len(earlier) :]
    mean, covariance = _mean(earlier[:-1] or earlier)
    if len(later) == 1:
        return _within(newest, mean, covariance, scatter, quiet)
    mean_later, covariance_later = _mean(later[1:])
    return Jump(DetectorEstimate.of(mean_later - mean, scaled(covariance + covariance_later, scatter.ratio) + quiet), 0)


def _within(
    looks: Sequence[DriftCheckPoint], mean: FloatArray, covariance: FloatArray, scatter: LookSpread, quiet: FloatArray
) -> Jump:
    """Average the jumps before each drift check, weighted by likelihood; outliers count as if at `OUTLYING`."""
    change, own = stacked(look.change for look in looks)
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
    return Jump(DetectorEstimate.of(size, spread), int(np.argmin(unlikely)))


def _mean(segments: Sequence[Segment]) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the segments' groups, and its covariance by the drift checks' own covariances."""
    covariance = inverse(np.sum([segment.precision[0] for segment in segments], axis=0))
    return times(covariance, np.sum([segment.weighted[0] for segment in segments], axis=0)), covariance


def _bounded(apart: FloatArray, precision: FloatArray) -> FloatArray:
    """Return chi-squared of each drift check; an outlier's is bounded."""
    return np.minimum(squared_length(apart, precision), OUTLYING**2)
