"""How much farther pooled groups of looks scatter than their covariances say."""

from dataclasses import dataclass

import numpy as np

from sawmill_worker.tomography.drift_chart.matrices import inverse, squared_length
from sawmill_worker.tomography.geometry import FloatArray

# Chi-squared of 2 degrees of freedom beyond which a difference counts as this: 1 of 400 is normal.
LARGEST = 12.0
# Covariances are believed as if this number of groups had shown them to be right.
BELIEVED = 20
# What a bounded difference of groups is in the mean, 2 r (1 - exp(-LARGEST / 2 r)), by the variance ratio r.
_RATIOS = np.geomspace(0.1, 100.0, 400)
_MEANS = 2.0 * _RATIOS * -np.expm1(-LARGEST / (2.0 * _RATIOS))


@dataclass(frozen=True, eq=False)
class Scatter:
    """Differences of neighbouring groups: neither a jump nor a trend moves more than a few of them.

    Attributes
    ----------
    differences : int
        How many.
    total : (...) float64
        Sum of their chi-squared, each at most `LARGEST`.
    mean, covariance : (..., 2), (..., 2, 2) float64
        Of the latest group.
    """

    differences: int
    total: FloatArray
    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def starting_at(cls, mean: FloatArray, covariance: FloatArray) -> "Scatter":
        """Before any difference."""
        return cls(0, np.zeros(mean.shape[:-1]), mean, covariance)

    def followed_by(self, mean: FloatArray, covariance: FloatArray) -> "Scatter":
        """With the difference from the latest group to the next one."""
        distance = squared_length(mean - self.mean, inverse(covariance + self.covariance))
        return Scatter(self.differences + 1, self.total + np.minimum(distance, LARGEST), mean, covariance)

    @property
    def variance_ratio(self) -> FloatArray:
        """What covariances are multiplied by, (...): 1 where groups scatter no more than they say."""
        if self.differences == 0:
            return np.ones_like(self.total)
        found = np.interp(self.total / self.differences, _MEANS, _RATIOS)
        ratio: FloatArray = (BELIEVED + self.differences * found) / (BELIEVED + self.differences)
        return np.maximum(ratio, 1.0)
