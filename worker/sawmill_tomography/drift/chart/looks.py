"""Looks: what single scans say of the change since the calibration; pooled, and set against a baseline."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.drift.chart.matrices import inverse, squared_length, times
from sawmill_tomography.geometry.geometry import FloatArray

# A look farther from the pooled estimate than this many standard deviations counts by as much as one at that distance
# (Huber 1964): 4 % of normal looks.
HUBER = 2.5
# A look farther away than this is an outlier and left out: 3 of 10 000 normal looks.
OUTLYING = 4.0
STEPS_WITH_ALL, STEPS_WITHOUT_OUTLIERS = 8, 4
# Looks that define zero: their pooled error is that of fifty later ones, so the difference is at most 1.41 times as
# uncertain as those; they take 36 minutes of a day of 2 000 logs.
BASELINE_LOOKS = 50
# Three looks can outvote one outlier.
FEWEST_BASELINE_LOOKS = 3


@dataclass(frozen=True, eq=False)
class Look:
    """What a scan says of the change since the calibration.

    Attributes
    ----------
    days : float
        When, in days since the calibration.
    change : (2,) float64
        Of u_c (mm on the detector) and the detector's tilt tau (rad).
    covariance : (2, 2) float64
        Of this scan's own error. The calibration's error is not in it: all looks share that.

    Raises
    ------
    ValueError
        If a value is not finite or the covariance is not positive definite.
    """

    days: float
    change: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        change, covariance = np.asarray(self.change, np.float64), np.asarray(self.covariance, np.float64)
        if change.shape != (2,) or covariance.shape != (2, 2):
            raise ValueError(
                f"a look has a change of shape (2,) and a covariance of shape (2, 2), not {change.shape} and "
                f"{covariance.shape}"
            )
        if not (np.isfinite(self.days) and np.isfinite(change).all() and np.isfinite(covariance).all()):
            raise ValueError(f"a look has finite values, not {self.days}, {change.tolist()}, {covariance.tolist()}")
        (first, cross), (also_cross, second) = covariance.tolist()
        symmetric = math.isclose(cross, also_cross, rel_tol=1e-6, abs_tol=1e-9 * math.sqrt(abs(first * second)))
        if not (symmetric and first > 0.0 and first * second > cross * also_cross):
            raise ValueError(f"a look's covariance is symmetric and positive definite, not {covariance.tolist()}")
        object.__setattr__(self, "change", change)
        object.__setattr__(self, "covariance", covariance)

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations, (2,), of u_c (mm) and tau (rad)."""
        deviation: FloatArray = np.sqrt(np.diag(self.covariance))
        return deviation


@dataclass(frozen=True, eq=False)
class PooledLook(Look):
    """Several looks as one.

    Attributes
    ----------
    days, change, covariance
        The looks' mean time; their generalised least squares estimate and its covariance.
    looks, outliers : int
        How many were given, and how many of those were left out.
    """

    looks: int
    outliers: int


class PooledMeans(NamedTuple):
    """Means (..., 2), their precision (..., 2, 2), and the looks' weights (..., looks), 0 of outliers."""

    mean: FloatArray
    precision: FloatArray
    weights: FloatArray


def pooled_means(change: FloatArray, covariance: FloatArray) -> PooledMeans:
    """Robust generalised least squares means over the last axis of looks.

    Huber's estimate (1964) of a location by reweighted least squares, distances taken in the metric of each look's own
    covariance; then without the looks that lie beyond `OUTLYING`.

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
    """Looks that are far away, but never more than half of them: then the distances are what is wrong."""
    far: NDArray[np.bool_] = (distance > OUTLYING) & (distance > np.median(distance, axis=-1, keepdims=True))
    return far


def stacked(looks: Sequence[Look]) -> tuple[FloatArray, FloatArray]:
    """Their changes (looks, 2) and covariances (looks, 2, 2)."""
    return np.stack([look.change for look in looks]), np.stack([look.covariance for look in looks])


def pooled(looks: Sequence[Look]) -> PooledLook:
    """One estimate from looks whose covariances may differ, without outliers.

    Raises
    ------
    ValueError
        If there is none.
    """
    if not looks:
        raise ValueError("0 looks cannot be pooled: give at least one")
    means = pooled_means(*stacked(looks))
    return PooledLook(
        float(np.mean([look.days for look in looks])),
        means.mean,
        inverse(means.precision),
        len(looks),
        int(np.count_nonzero(means.weights == 0.0)),
    )


@dataclass(frozen=True, eq=False)
class Baseline:
    """The first looks after a calibration, which define zero.

    An error that every look makes alike (a flat field with a slope, a calibration that was off) is in the baseline and
    in each later look: their difference does not hold it. What changes since (the slope itself, other logs) stays.

    Attributes
    ----------
    estimate : PooledLook
        What later looks are compared with; its error is in every difference.
    until_days : float
        Time of its last look, in days since the calibration.
    """

    estimate: PooledLook
    until_days: float

    @classmethod
    def of(cls, looks: Sequence[Look]) -> "Baseline":
        """Of the looks given, usually the first `BASELINE_LOOKS`.

        Raises
        ------
        ValueError
            If there are fewer than `FEWEST_BASELINE_LOOKS`.
        """
        if len(looks) < FEWEST_BASELINE_LOOKS:
            given = "1 look makes" if len(looks) == 1 else f"{len(looks)} looks make"
            raise ValueError(f"{given} no baseline: {FEWEST_BASELINE_LOOKS} or more are needed")
        return cls(pooled(looks), max(look.days for look in looks))
