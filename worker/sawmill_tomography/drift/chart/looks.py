"""Drift checks: a single scan's change since the calibration; several pooled into one, and a baseline.

Their scatter is compared with that by their covariances; 2 x 2 matrices are in closed form.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DetectorEstimate

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
        return np.asarray(np.einsum("...ik,...k,...jk->...ij", directions, np.maximum(more, 1.0), directions))

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
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))


def squared_length(vectors: FloatArray, precision: FloatArray) -> FloatArray:
    """Return x^T P x (...), for vectors (..., 2), matrices (..., 2, 2): chi-squared if P is the inverse covariance."""
    return np.asarray(np.einsum("...i,...ij,...j->...", vectors, precision, vectors))


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


# A check farther from the pooled estimate than this many standard deviations counts by as much as one at that distance
# (Huber 1964): 4 % of normal checks.
HUBER = 2.5
# A drift check farther away than this is an outlier and left out: 3 of 10 000 normal checks.
OUTLYING = 4.0
STEPS_WITH_ALL, STEPS_WITHOUT_OUTLIERS = 8, 4
# Drift checks that define zero: their pooled error equals the error of fifty later ones, so the difference is at most
# 1.41 times as uncertain as fifty checks; they take 36 minutes of a day of 2 000 logs.
BASELINE_LOOKS = 50
# Three drift checks can outvote one outlier.
FEWEST_BASELINE_LOOKS = 3


@dataclass(frozen=True)
class DriftCheckPoint:
    """A drift check: a scan's change since the calibration.

    Raises
    ------
    ValueError
        If a value is not finite or the covariance is not positive definite.
    """

    days: float  # time of the scan, in days since the calibration
    change: DetectorEstimate  # with this scan's own error, without the calibration's, which all drift checks share

    def __post_init__(self) -> None:
        (first, cross), (also_cross, second) = self.change.covariance
        if not np.isfinite([self.days, *self.change.values, first, cross, also_cross, second]).all():
            raise ValueError(f"a look has finite values, not {self.days} and {self.change}")
        symmetric = math.isclose(cross, also_cross, rel_tol=1e-6, abs_tol=1e-9 * math.sqrt(abs(first * second)))
        if not (symmetric and self.change.relative_determinant > 0.0):
            raise ValueError(f"a look's covariance is symmetric and positive definite, not {self.change.covariance}")


@dataclass(frozen=True)
class PooledDriftCheckPoint(DriftCheckPoint):
    """Several drift checks pooled into one."""

    looks: int  # number of pooled checks, and number of outliers among them that were left out
    outliers: int


class PooledMeans(NamedTuple):
    """Means (..., 2), their precision (..., 2, 2), and the drift checks' weights (..., looks), 0 for outliers."""

    mean: FloatArray
    precision: FloatArray
    weights: FloatArray


def pooled_means(change: FloatArray, covariance: FloatArray) -> PooledMeans:
    """Compute robust generalised least squares means over the last axis of drift checks.

    Huber's estimate (1964) of a location by reweighted least squares, distances taken in the metric of each check's own
    covariance; then without the checks beyond `OUTLYING`.

    Parameters
    ----------
    change : (..., looks, 2) float64
    covariance : (..., looks, 2, 2) float64
    """
    own = inverse(covariance)
    weighted = times(own, change)
    weights: FloatArray = np.ones(change.shape[:-1])
    for step in range(STEPS_WITH_ALL + STEPS_WITHOUT_OUTLIERS):
        precision = np.einsum("...k,...kij->...ij", weights, own)
        mean = times(inverse(precision), np.einsum("...k,...ki->...i", weights, weighted))
        distance = np.sqrt(squared_length(change - mean[..., None, :], own))
        weights = HUBER / np.maximum(distance, HUBER)
        if step >= STEPS_WITH_ALL - 1:
            # Never more than half of the checks: then the distances are what is wrong.
            is_outlying = (distance > OUTLYING) & (distance > np.median(distance, axis=-1, keepdims=True))
            weights = np.where(is_outlying, 0.0, weights)
    precision = np.einsum("...k,...kij->...ij", weights, own)
    mean = times(inverse(precision), np.einsum("...k,...ki->...i", weights, weighted))
    return PooledMeans(mean, precision, weights)


def stacked(changes: Iterable[DetectorEstimate]) -> tuple[FloatArray, FloatArray]:
    """Stack the values (looks, 2) and the covariances (looks, 2, 2) of the drift checks' changes."""
    values, covariances = zip(*((change.values, change.covariance) for change in changes), strict=True)
    return np.array(values), np.array(covariances)


def pooled(looks: Sequence[DriftCheckPoint]) -> PooledDriftCheckPoint:
    """Estimate one change from drift checks whose covariances may differ, without outliers."""
    if not looks:
        raise ValueError("0 looks cannot be pooled: give at least one")
    means = pooled_means(*stacked(look.change for look in looks))
    return PooledDriftCheckPoint(
        float(np.mean([look.days for look in looks])),
        DetectorEstimate.of(means.mean, inverse(means.precision)),
        len(looks),
        int(np.count_nonzero(means.weights == 0.0)),
    )


@dataclass(frozen=True)
class Baseline:
    """The first drift checks after a calibration, which define zero.

    An error that every drift check has alike (a flat field with a slope, a calibration that was off) is in the baseline
    and in each later check: their difference does not contain it. Later changes (of the slope itself, other logs)
    remain.
    """

    # The estimate with which later drift checks are compared; its error is in every difference
    estimate: PooledDriftCheckPoint
    until_days: float  # time of the baseline's last drift check, in days since the calibration

    @classmethod
    def of(cls, looks: Sequence[DriftCheckPoint]) -> "Baseline":
        """Return the baseline of some drift checks, usually the first `BASELINE_LOOKS`.

        Raises
        ------
        ValueError
            If there are fewer than `FEWEST_BASELINE_LOOKS`.
        """
        if len(looks) < FEWEST_BASELINE_LOOKS:
            number = "1 look makes" if len(looks) == 1 else f"{len(looks)} looks make"
            raise ValueError(f"{number} no baseline: {FEWEST_BASELINE_LOOKS} or more are needed")
        return cls(pooled(looks), max(look.days for look in looks))
