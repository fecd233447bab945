"""Drift checks: a single scan's change since the calibration; several pooled into one, and a baseline."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.drift.chart.spread import inverse, squared_length, times
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DetectorEstimate

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
            weights = np.where(_outlying(distance), 0.0, weights)
    precision = np.einsum("...k,...kij->...ij", weights, own)
    mean = times(inverse(precision), np.einsum("...k,...ki->...i", weights, weighted))
    return PooledMeans(mean, precision, weights)


def _outlying(distance: FloatArray) -> NDArray[np.bool_]:
    """Select far drift checks, but never more than half of them: then the distances are what is wrong."""
    return (distance > OUTLYING) & (distance > np.median(distance, axis=-1, keepdims=True))


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
