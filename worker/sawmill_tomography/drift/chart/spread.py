"""The ratio of the scatter of drift checks to the scatter by their covariances."""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.drift.chart.matrices import inverse, squared_length, whitened
from sawmill_tomography.geometry.geometry import FloatArray

# A whitened difference with a larger chi-squared (2 degrees of freedom) counts as one of this: 1 of 400 normal ones.
LARGEST = 12.0
# Covariances are believed as if this number of differences had shown them to be right.
BELIEVED = 5
# Neighbouring differences share a drift check: the variance of their mean square is larger by this factor.
SHARED = 1.5


@dataclass(frozen=True, eq=False)
class LookSpread:
    """Scatter from differences of neighbours (checks, then groups): a jump or trend affects few of them."""

    differences: int  # number of differences
    squares: FloatArray  # (..., 2, 2)
    mean: FloatArray  # (..., 2): mean and covariance of the latest drift check or group
    covariance: FloatArray  # (..., 2, 2)

    @classmethod
    def of_looks(cls, change: FloatArray, covariance: FloatArray) -> "LookSpread":
        """Return the scatter of a baseline's drift checks: (..., looks, 2) and (..., looks, 2, 2)."""
        scatter = cls(0, np.zeros_like(covariance[..., 0, :, :]), change[..., 0, :], covariance[..., 0, :, :])
        for look in range(1, change.shape[-2]):
            scatter = scatter.followed_by(change[..., look, :], covariance[..., look, :, :])
        return scatter

    def followed_by(self, mean: FloatArray, covariance: FloatArray) -> "LookSpread":
        """Return the scatter with the difference from the latest to the next check or group."""
        white = whitened(mean - self.mean, covariance + self.covariance)
        distance = squared_length(white, inverse(self._estimate))
        bounded = white * np.sqrt(LARGEST / np.maximum(distance, LARGEST))[..., None]
        squares = self.squares + bounded[..., :, None] * bounded[..., None, :]
        return LookSpread(self.differences + 1, squares, mean, covariance)

    @property
    def ratio(self) -> FloatArray:
        """Covariance of the whitened differences, (..., 2, 2): the unit matrix if the checks' covariances are right.

        A direction with less scatter than the covariances imply keeps them as they are.
        """
        more, directions = np.linalg.eigh(self._estimate)
        ratio: FloatArray = np.einsum("...ik,...k,...jk->...ij", directions, np.maximum(more, 1.0), directions)
        return ratio

    def chi_squared(self, distance: FloatArray) -> FloatArray:
        """Convert a squared length by this scatter's covariances to the equally rare chi-squared, 2 degrees of freedom.

        The scatter is an estimate: a length may also be large because the estimate is too small. Hotelling (1931,
        Annals of Mathematical Statistics 2, 360): with f degrees of freedom x^2 is beyond t with the probability
        (1 + t / f)^(-(f - 1) / 2), and chi-squared is beyond c with exp(-c / 2).
        """
        freedom = (BELIEVED + self.differences) / SHARED
        alike: FloatArray = (freedom - 1.0) * np.log1p(distance / freedom)
        return alike

    @property
    def _estimate(self) -> FloatArray:
        estimate: FloatArray = (BELIEVED * np.eye(2) + self.squares) / (BELIEVED + self.differences)
        return estimate
