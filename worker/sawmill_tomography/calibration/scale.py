"""The uncertainty of the image's millimetres: a common scale, for which the phantom's size is the ruler."""

import math
from dataclasses import dataclass
from enum import Enum

from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import scale_deviation, scale_ray_error
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.statistics import TWO_SIDED_95


class ScaleSource(Enum):
    """A cause of the scale's uncertainty."""

    SIZE = "the phantom's size tolerance"
    NOISE = "the error of R/SDD"
    ASPECT = "the phantom's aspect"


@dataclass(frozen=True)
class ScaleUncertainty:
    """Uncertainty of the common scale, in shares of the scale; effects of the size tolerance alone are in mm."""

    source_distance_mm: float  # uncertainties of R and of the rays (RMS) that follow from the size tolerance
    ray_error_mm: float
    size: float  # standard uncertainties: the size tolerance; the error of R/SDD by the covariance
    statistical: float = 0.0
    aspect_half: float = 0.0

    @property
    def percent_95(self) -> float:
        """Uncertainty of the scale, 95 %: standard uncertainties in quadrature, plus the share of the aspect."""
        return 100.0 * (TWO_SIDED_95 * math.hypot(self.size, self.statistical) + self.aspect_half)

    @property
    def largest(self) -> ScaleSource:
        """The cause that contributes most."""
        shares = {
            ScaleSource.SIZE: TWO_SIDED_95 * self.size,
            ScaleSource.NOISE: TWO_SIDED_95 * self.statistical,
            ScaleSource.ASPECT: self.aspect_half,
        }
        return max(shares, key=lambda source: shares[source])


def scale_uncertainty(
    scanner: Scanner,
    frame: SourceFrame,
    phantom: Phantom,
    covariance: FloatArray | None,
    radius_mm: float,
    *,
    aspect_half: float = 0.0,
) -> ScaleUncertainty:
    """Compute the uncertainty for rays inside a disc of this radius around the COR.

    docs/understand/verdict.md#the-scale has the derivation.

    `covariance` (5, 5) or None: covariance of (psi, R, SDD, u_c, tau); None where there are no error bars, which then
    count as zero.
    """
    size = phantom.size_tolerance
    return ScaleUncertainty(
        source_distance_mm=size * frame.source_distance_mm,
        ray_error_mm=scale_ray_error(scanner, frame, size, radius_mm=radius_mm),
        size=size,
        statistical=0.0 if covariance is None else scale_deviation(scanner, frame, covariance, radius_mm=radius_mm),
        aspect_half=aspect_half,
    )


def size_by_distance(found_mm: float, known_mm: float) -> dict[str, float | str]:
    """Describe the phantom whose scan puts the source at one distance from the COR where another is known.

    The values are those of a message: by how many per cent the phantom is smaller or larger than its drawing.
    """
    size = "smaller" if found_mm > known_mm else "larger"
    return {"by_percent": 100.0 * abs(known_mm / found_mm - 1.0), "size": size}
