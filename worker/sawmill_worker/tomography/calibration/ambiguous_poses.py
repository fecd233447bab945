"""Poses in which a body that is nearly itself turned, or seen from behind, shows almost the same sinogram."""

import math
from dataclasses import replace

import numpy as np

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.calibration.misfit import CoarseMisfit
from sawmill_worker.tomography.calibration.task import Hypothesis
from sawmill_worker.tomography.geometry import SourceFrame, wrap_angle
from sawmill_worker.vocabulary import Handedness

# Peaks of the correlation over the first angle that are fitted; a peak within 10 degrees of the fit is the fit itself.
PEAKS = 4
OWN_PEAK = math.radians(10.0)

# The handedness, the geometry with the turned first angle, and the phantom's position (x, y) in mm.
Pose = tuple[Handedness, SourceFrame, tuple[float, float]]


def ambiguous_poses(
    misfit: CoarseMisfit, found: Hypothesis, at: SourceFrame, position_mm: tuple[float, float]
) -> list[Pose]:
    """Poses whose projection correlates with the scan in a peak of its own.

    In each pose the centroid stays where the fit at `at` and `position_mm` sees it.
    """
    angles, turns = found.rotation.apply(misfit.angles_rad), misfit.table_rad[::2]
    centroid = complex(*misfit.phantoms[found.handedness].centroid_mm) + complex(*position_mm)
    poses: list[Pose] = []
    for other, phantom in misfit.phantoms.items():
        places = np.exp(1j * turns) * centroid - complex(*phantom.centroid_mm)
        frames = [replace(at, psi_rad=wrap_angle(at.psi_rad + turn)) for turn in turns]
        correlation = np.full(turns.size, -1.0)
        for index, (place, frame) in enumerate(zip(places, frames, strict=True)):
            if analytic.clears(phantom.radius_mm + abs(place), frame):
                model = analytic.project(phantom, misfit.cells, frame, angles, position_mm=(place.real, place.imag))
                # A pose that no view shows correlates with nothing.
                if np.ptp(model) > 0.0:
                    correlation[index] = np.corrcoef(model.ravel(), misfit.sinogram.ravel())[0, 1]
        peak = (correlation > np.roll(correlation, 1)) & (correlation >= np.roll(correlation, -1))
        if other is found.handedness:
            peak &= np.abs(np.angle(np.exp(1j * turns))) > OWN_PEAK
        best = sorted(np.flatnonzero(peak), key=lambda index: -correlation[index])[:PEAKS]
        poses += [(other, frames[index], (places[index].real, places[index].imag)) for index in best]
    return poses
