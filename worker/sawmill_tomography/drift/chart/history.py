"""A scanner's history since its calibration, reduced to what the chart needs. Arrays may have leading axes."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

from sawmill_tomography.drift.chart.alternatives import StepAndTrendFits, steps_and_trends
from sawmill_tomography.drift.chart.matrices import inverse
from sawmill_tomography.drift.chart.segments import Segment, extended
from sawmill_tomography.drift.chart.spread import LookSpread
from sawmill_tomography.geometry.geometry import FloatArray

# One pooled group: its last time (...) in days, mean (..., 2) and covariance (..., 2, 2).
Group = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class History:
    """The groups of drift checks in segments, and the scatter of checks and groups."""

    segments: tuple[Segment, ...]  # oldest first
    scatter: LookSpread

    @classmethod
    def starting_with(cls, groups: Iterable[Group], scatter: LookSpread) -> "History":
        """Return the history of a baseline's groups, oldest first, with the scatter of the baseline's drift checks."""
        return cls(reduce(extended, (_segment(*group) for group in groups), ()), scatter)

    def followed_by(self, days: FloatArray, mean: FloatArray, covariance: FloatArray) -> "History":
        """Return the history with one more `Group`."""
        newest = _segment(days, mean, covariance)
        return History(extended(self.segments, newest), self.scatter.followed_by(mean, covariance))

    def alternatives(self, quiet: FloatArray) -> tuple[StepAndTrendFits, StepAndTrendFits]:
        """Fit steps and trends to the segments (`steps_and_trends`)."""
        return steps_and_trends(self.segments, self.scatter, quiet)


def _segment(days: FloatArray, mean: FloatArray, covariance: FloatArray) -> Segment:
    return Segment.of_group(days, mean, inverse(covariance))
