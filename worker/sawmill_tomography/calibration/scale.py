"""How well the image's millimetres are known: a common scale, of which the phantom's size is the ruler."""

import math
from dataclasses import dataclass
from enum import Enum

from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import scale_deviation, scale_ray_error
from sawmill_tomography.phantoms.phantom import Phantom

# Of a normal distribution: 95 % lie within this number of standard deviations of its mean.
TWO_SIDED_95 = 1.96


class ScaleSource(Enum):
    """What makes the scale uncertain."""

    SIZE = "the phantom's size tolerance"
    NOISE = "the error of R/SDD"
    ASPECT = "the phantom's aspect"


@dataclass(frozen=True)
class ScaleUncertainty:
    """Of the common scale, as shares of it, and of what follows from the phantom's size tolerance alone, in mm.

    Attributes
    ----------
    source_distance_mm, ray_error_mm : float
        What R, and the rays (RMS), inherit from the size tolerance.
    size, statistical : float
        Standard uncertainties: the size tolerance; the error of R/SDD by the covariance.
    aspect_half : float
        Half the difference between the phantom's directions, of which none is known to be the true one.
    """

    source_distance_mm: float
    ray_error_mm: float
    size: float
    statistical: float = 0.0
    aspect_half: float = 0.0

    @property
    def percent_95(self) -> float:
        """The scale is right to this with 95 %: standard uncertainties in quadrature, the aspect's share added."""
        standard = math.hypot(self.size, self.statistical)
        return 100.0 * (TWO_SIDED_95 * standard + self.aspect_half)

    @property
    def largest(self) -> ScaleSource:
        """What contributes most."""
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
    """For rays inside a disc of this radius around the COR (docs/geometry.md#the-scale).

    Parameters
    ----------
    covariance : (5, 5) float64 or None
        Of (psi, R, SDD, u_c, tau); None where there are no error bars, which then count as zero.
    aspect_half : float
        As of `ScaleUncertainty`.
    """
    size = phantom.size_tolerance
    return ScaleUncertainty(
        source_distance_mm=size * frame.source_distance_mm,
        ray_error_mm=scale_ray_error(scanner, frame, size, radius_mm=radius_mm),
        size=size,
        statistical=0.0 if covariance is None else scale_deviation(scanner, frame, covariance, radius_mm=radius_mm),
        aspect_half=aspect_half,
    )
