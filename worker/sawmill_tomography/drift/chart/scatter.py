"""How much farther looks scatter than their covariances say."""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.drift.chart.matrices import inverse, squared_length, whitened
from sawmill_tomography.geometry.geometry import FloatArray

# A difference whose chi-squared of 2 degrees of freedom is larger counts as one of this: 1 of 400 is normal.
LARGEST = 12.0
# Covariances are believed as if this number of differences had shown them to be right.
BELIEVED = 5
# Neighbouring differences share a look: the variance of their mean square is larger by this.
SHARED = 1.5


@dataclass(frozen=True, eq=False)
class Scatter:
    """Differences of neighbours, looks of a baseline and then groups: a jump or a trend moves few of them.

    Attributes
    ----------
    differences : int
        How many.
    squares : (..., 2, 2) float64
        Sum of z z^T of the whitened differences z, each bounded by what those before it have shown (Huber 1964).
    mean, covariance : (..., 2), (..., 2, 2) float64
        Of the latest look or group.
    """

    differences: int
    squares: FloatArray
    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def of_looks(cls, change: FloatArray, covariance: FloatArray) -> "Scatter":
        """Of a baseline's looks: (..., looks, 2) and (..., looks, 2, 2)."""
        scatter = cls(0, np.zeros_like(covariance[..., 0, :, :]), change[..., 0, :], covariance[..., 0, :, :])
        for look in range(1, change.shape[-2]):
            scatter = scatter.followed_by(change[..., look, :], covariance[..., look, :, :])
        return scatter

    def followed_by(self, mean: FloatArray, covariance: FloatArray) -> "Scatter":
        """With the difference from the latest to the next one."""
        white = whitened(mean - self.mean, covariance + self.covariance)
        distance = squared_length(white, inverse(self._found))
        bounded = white * np.sqrt(LARGEST / np.maximum(distance, LARGEST))[..., None]
        squares = self.squares + bounded[..., :, None] * bounded[..., None, :]
        return Scatter(self.differences + 1, squares, mean, covariance)

    @property
    def ratio(self) -> FloatArray:
        """What a whitened covariance is, (..., 2, 2): the unit matrix where looks scatter no more than they say.

        In directions in which they scatter less, they are believed as they are.
        """
        more, directions = np.linalg.eigh(self._found)
        ratio: FloatArray = np.einsum("...ik,...k,...jk->...ij", directions, np.maximum(more, 1.0), directions)
        return ratio

    def chi_squared(self, distance: FloatArray) -> FloatArray:
        """A squared length by covariances of this scatter as the chi-squared of 2 degrees of freedom that is as rare.

        The scatter is an estimate: what is large by it may also be so because it is too small. Hotelling (1931, Annals
        of Mathematical Statistics 2, 360): with f degrees of freedom x^2 is beyond t with the probability
        (1 + t / f)^(-(f - 1) / 2), and chi-squared is beyond c with exp(-c / 2).
        """
        freedom = (BELIEVED + self.differences) / SHARED
        alike: FloatArray = (freedom - 1.0) * np.log1p(distance / freedom)
        return alike

    @property
    def _found(self) -> FloatArray:
        found: FloatArray = (BELIEVED * np.eye(2) + self.squares) / (BELIEVED + self.differences)
        return found
