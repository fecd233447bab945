"""A scanner's history since its calibration, as much of it as the chart needs. Arrays may have leading axes."""

from dataclasses import dataclass

from sawmill_worker.tomography.drift_chart.alternatives import Alternatives, steps_and_trends
from sawmill_worker.tomography.drift_chart.matrices import inverse
from sawmill_worker.tomography.drift_chart.scatter import Scatter
from sawmill_worker.tomography.drift_chart.segments import Segment, extended
from sawmill_worker.tomography.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class History:
    """The baseline, what followed in segments, and how groups of looks scatter.

    Attributes
    ----------
    baseline : Segment
        Never joined with what follows.
    segments : tuple of Segment
        Oldest first.
    """

    baseline: Segment
    segments: tuple[Segment, ...]
    scatter: Scatter

    @classmethod
    def starting_at(cls, days: FloatArray, mean: FloatArray, covariance: FloatArray, scatter: Scatter) -> "History":
        """With the baseline alone: its last time (...), mean (..., 2), covariance (..., 2, 2) and looks' scatter."""
        return cls(Segment.of_group(days, mean, inverse(covariance)), (), scatter)

    def followed_by(self, days: FloatArray, mean: FloatArray, covariance: FloatArray) -> "History":
        """With one pooled group more: its mean time (...), mean (..., 2) and covariance (..., 2, 2)."""
        newest = Segment.of_group(days, mean, inverse(covariance))
        return History(self.baseline, extended(self.segments, newest), self.scatter.followed_by(mean, covariance))

    def alternatives(self, quiet: FloatArray) -> tuple[Alternatives, Alternatives]:
        """Steps and trends, as `steps_and_trends`; there must be a segment."""
        return steps_and_trends((self.baseline, *self.segments), self.scatter, quiet)
