"""The ratio of the scatter of drift checks to that by their covariances, and 2 x 2 matrices in closed form."""

from dataclasses import dataclass

import numpy as np

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
        return (freedom - 1.0) * np.log1p(distance / freedom)

    @property
    def _estimate(self) -> FloatArray:
        return (BELIEVED * np.eye(2) + self.squares) / (BELIEVED + self.differences)


def inverse(matrices: FloatArray) -> FloatArray:
    """Return the inverses (..., 2, 2) of positive definite matrices; zeros for singular matrices."""
    first, cross, second = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    determinant = first * second - cross**2
    # A determinant below the rounding error of its two terms is zero.
    regular = determinant > 4.0 * np.finfo(float).eps * np.abs(first * second)
    over = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=regular)
    return (np.stack([second, -cross, -cross, first], axis=-1) * over[..., None]).reshape(matrices.shape)


def times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the products (..., 2) of matrices (..., 2, 2) and vectors (..., 2)."""
    first, second = vectors[..., 0], vectors[..., 1]
    return np.stack([row[..., 0] * first + row[..., 1] * second for row in np.moveaxis(matrices, -2, 0)], axis=-1)


def squared_length(vectors: FloatArray, precision: FloatArray) -> FloatArray:
    """Return x^T P x (...), for vectors (..., 2), matrices (..., 2, 2): chi-squared if P is the inverse covariance."""
    first, second = vectors[..., 0], vectors[..., 1]
    return (
        precision[..., 0, 0] * first**2 + 2.0 * precision[..., 0, 1] * first * second + precision[..., 1, 1] * second**2
    )


def sandwich(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Return A B A, (..., 2, 2)."""
    columns = (times(outer, times(inner, outer[..., :, k])) for k in range(2))
    return np.stack(list(columns), axis=-1)


def whitened(vectors: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return L^-1 x, (..., 2), with L the lower Cholesky factor of the covariance (..., 2, 2)."""
    first, cross, second = _cholesky(covariance)
    along = vectors[..., 0] / first
    return np.stack([along, (vectors[..., 1] - cross * along) / second], axis=-1)


def scaled(covariance: FloatArray, ratio: FloatArray) -> FloatArray:
    """Return L M L^T, (..., 2, 2), with L the lower Cholesky factor of the covariance and M the ratio (..., 2, 2)."""
    first, cross, second = _cholesky(covariance)
    upper, mixed, lower = ratio[..., 0, 0], ratio[..., 0, 1], ratio[..., 1, 1]
    off = first * (upper * cross + mixed * second)
    last = upper * cross**2 + 2.0 * mixed * cross * second + lower * second**2
    return np.stack([first**2 * upper, off, off, last], axis=-1).reshape(covariance.shape)


def _cholesky(covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the factor's upper left, lower left and lower right elements, (...) each; zeros for a zero matrix."""
    first = np.sqrt(covariance[..., 0, 0])
    cross = np.divide(covariance[..., 1, 0], first, out=np.zeros_like(first), where=first > 0.0)
    return first, cross, np.sqrt(np.maximum(covariance[..., 1, 1] - cross**2, 0.0))
