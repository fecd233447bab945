"""The systematic error from the phantom's size: it scales the geometry, and no residual shows it."""

from dataclasses import dataclass

from sawmill_worker.tomography.geometry import Scanner, SourceFrame
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.tomography.ray_error import scale_ray_error


@dataclass(frozen=True)
class ScaleUncertainty:
    """What R, and the rays (RMS), inherit from the phantom's size tolerance, in mm."""

    source_distance_mm: float
    ray_error_mm: float


def scale_uncertainty(scanner: Scanner, frame: SourceFrame, phantom: Phantom, radius_mm: float) -> ScaleUncertainty:
    """For rays inside a disc of this radius around the COR."""
    return ScaleUncertainty(
        phantom.size_tolerance * frame.source_distance_mm,
        scale_ray_error(scanner, frame, phantom.size_tolerance, radius_mm=radius_mm),
    )
