"""How far from the rotation centre a scan shows anything."""

import math

import numpy as np

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, GeometryError, cell_centres_mm
from sawmill_tomography.projection.projector import Image
from sawmill_tomography.sinograms.air import find_air


def check_shown(lines: Image) -> None:
    """See that every slice (slices, views, detector) shows something: where none does there is no scale to solve by.

    Raises
    ------
    GeometryError
        If a slice is 0 in every ray.
    """
    shown = lines.any(axis=(1, 2))
    if not shown.all():
        raise GeometryError(
            f"slice {int(np.argmin(shown))}, counted from 0, is 0 in every ray, and so is its image: leave it out"
        )


def object_radius_mm(geometry: FanBeamGeometry, sinogram: Image) -> float:
    """Radius of the disc around the COR that holds what a sinogram (views, detector) shows.

    The farthest ray through other cells than those that are air in every view: it passes the COR at R sin(gamma), gamma
    of docs/conventions.md#source-frame. An object that reaches an end of the detector is held by what that end sees. 0
    where all is air.
    """
    air = find_air(sinogram)
    shadowed = np.ones(sinogram.shape[1], bool) if air is None else ~air.cells
    return _radius_mm(geometry, cell_centres_mm(geometry.scanner)[shadowed]) if shadowed.any() else 0.0


def seen_radius_mm(geometry: FanBeamGeometry) -> float:
    """Radius of the disc around the COR that the whole detector sees: no object's is larger."""
    return _radius_mm(geometry, cell_centres_mm(geometry.scanner))


def _radius_mm(geometry: FanBeamGeometry, centres: FloatArray) -> float:
    """Of the disc around the COR that the farthest ray to cells with these centres passes."""
    scanner, frame = geometry.scanner, geometry.frame
    half = 0.5 * scanner.detector_pitch_mm
    ends = np.array([centres.min() - half, centres.max() + half]) - frame.cor_column_mm
    gamma = np.arctan2(ends * math.cos(frame.tilt_rad), frame.source_to_detector_mm + ends * math.sin(frame.tilt_rad))
    return float(frame.source_distance_mm * np.abs(np.sin(gamma)).max())
