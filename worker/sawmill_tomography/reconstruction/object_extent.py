"""The extent of the object in a scan, as a distance from the rotation centre."""

import numpy as np

from sawmill_tomography.geometry.geometry import FanViews, FloatArray, GeometryError
from sawmill_tomography.projection.projector import Image
from sawmill_tomography.sinograms.air import find_air


def check_shown(lines: Image) -> None:
    """Check that every slice (slices, views, detector) shows something: otherwise it has no scale to solve by."""
    shown = lines.any(axis=(1, 2))
    if not shown.all():
        raise GeometryError(
            f"slice {int(np.argmin(shown))}, counted from 0, is 0 in every ray, and so is its image: leave it out"
        )


def object_radius_mm(geometry: FanViews, sinogram: Image) -> float:
    """Return the radius of the disc around the COR that holds the object in a sinogram (views, detector).

    It is the distance R sin(gamma) at which the farthest ray through cells that are not air in every view passes the
    COR (gamma: docs/look-up/conventions.md#source-frame). If the object reaches an end of the detector, the ray at
    that end counts. 0 if all cells are air.
    """
    air = find_air(sinogram)
    shadowed = np.ones(sinogram.shape[1], bool) if air is None else ~air.cells
    return _radius_mm(geometry, geometry.borders_mm[shadowed]) if shadowed.any() else 0.0


def seen_radius_mm(geometry: FanViews) -> float:
    """Return the radius of the disc around the COR that the whole detector sees: no object's is larger."""
    return _radius_mm(geometry, geometry.borders_mm)


def _radius_mm(geometry: FanViews, borders: FloatArray) -> float:
    """Return the radius of the disc around the COR that the farthest ray to cells with these borders touches."""
    return float(geometry.from_cor_mm(np.array([borders.min(), borders.max()])).max())
