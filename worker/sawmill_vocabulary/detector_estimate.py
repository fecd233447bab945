"""The detector's place and tilt as a scan shows them, with their errors: fits, charts, rules and rows share this value.

Contracts and sentences write the tilt in degrees; everything else has radians.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

PairCovariance = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class DetectorEstimate:
    """An estimate of u_c and tau, or of a change of them."""

    cor_column_mm: float  # u_c, where the centre of rotation falls on the detector, and tau, the detector's tilt
    tilt_rad: float
    covariance: PairCovariance  # (2, 2) float: covariance of (u_c, tau), in mm and radians

    @classmethod
    def of(cls, values: Iterable[float], covariance: Iterable[Iterable[float]]) -> Self:
        """Build an estimate from numbers in the order (u_c, tau): arrays, lists or tuples."""
        try:
            column, tilt = (float(value) for value in values)
            (first, cross), (also_cross, second) = ((float(value) for value in row) for row in covariance)
        except ValueError as error:
            raise ValueError(f"u_c and tau are 2 values with a covariance of 2 x 2 values: {error}") from error
        return cls(column, tilt, ((first, cross), (also_cross, second)))

    @property
    def values(self) -> tuple[float, float]:
        """The two numbers, (u_c, tau)."""
        return self.cor_column_mm, self.tilt_rad

    @property
    def deviations(self) -> tuple[float, float]:
        """Standard deviations of (u_c, tau)."""
        (first, _), (_, second) = self.covariance
        return math.sqrt(first), math.sqrt(second)

    @property
    def relative_determinant(self) -> float:
        """Determinant of the covariance divided by the product of the variances.

        It is 1 without correlation; a covariance with 0 or less has no inverse.
        """
        (first, cross), (also_cross, second) = self.covariance
        known = all(map(math.isfinite, (*self.values, first, cross, also_cross, second)))
        return 1.0 - cross * also_cross / (first * second) if known and min(first, second) > 0.0 else 0.0
