"""The extent of the object in a scan, as a distance from the rotation centre."""

import math

import numpy as np

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, GeometryError
from sawmill_tomography.geometry.modules import flat_centres_mm
from sawmill_tomography.projection.projector import Image
from sawmill_tomography.sinograms.air import find_air


def check_shown(lines: Image) -> None:
    """Check that every slice (slices, views, detector) shows something: otherwise it has no scale to solve by."""
    shown = lines.any(axis=(1, 2))
    if not shown.all():
        raise GeometryError(
            f"slice {int(np.argmin(shown))}, counted from 0, is 0 in every ray, and so is its image: leave it out"
        )


def object_radius_mm(geometry: FanBeamGeometry, sinogram: Image) -> float:
    """Return the radius of the disc around the COR that holds the object in a sinogram (views, detector).

    It is the distance R sin(gamma) at which the farthest ray through cells that are not air in every view passes the
    COR (gamma: docs/look-up/conventions.md#source-frame). If the object reaches an end of the detector, the ray at
    that end counts. 0 if all cells are air.
    """
    air = find_air(sinogram)
    shadowed = np.ones(sinogram.shape[1], bool) if air is None else ~air.cells
    return _radius_mm(geometry, flat_centres_mm(geometry.scanner, geometry.frame)[shadowed]) if shadowed.any() else 0.0


def seen_radius_mm(geometry: FanBeamGeometry) -> float:
    """Return the radius of the disc around the COR that the whole detector sees: no object's is larger."""
    return _radius_mm(geometry, flat_centres_mm(geometry.scanner, geometry.frame))


def _radius_mm(geometry: FanBeamGeometry, centres: FloatArray) -> float:
    """Return the radius of the disc around the COR that the farthest ray to cells with these centres touches."""
    scanner, frame = geometry.scanner, geometry.frame
    half = 0.5 * scanner.detector_pitch_mm
    ends = np.array([centres.min() - half, centres.max() + half]) - frame.cor_column_mm
    gamma = np.arctan2(ends * math.cos(frame.tilt_rad), frame.source_to_detector_mm + ends * math.sin(frame.tilt_rad))
    return float(frame.source_distance_mm * np.abs(np.sin(gamma)).max())
