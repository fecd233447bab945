"""Poses that show almost the same sinogram, because the body is nearly symmetric when turned or seen from behind."""

import math
from dataclasses import replace

import numpy as np

from sawmill_tomography.calibration.search.misfit import CoarseMisfit
from sawmill_tomography.calibration.task import PoseHypothesis
from sawmill_tomography.geometry.geometry import SourceFrame, wrap_angle
from sawmill_tomography.projection import analytic
from sawmill_vocabulary import Handedness

# Peaks of the correlation over the first angle that are fitted; a peak within 10 degrees of the fit is the fit itself.
PEAKS = 4
OWN_PEAK = math.radians(10.0)
# This number of the coarse views shows where the peaks are.
VIEWS = 20

# The handedness, the geometry with the turned first angle, and the phantom's position (x, y) in mm.
Pose = tuple[Handedness, SourceFrame, tuple[float, float]]


def ambiguous_poses(
    misfit: CoarseMisfit, hypothesis: PoseHypothesis, at: SourceFrame, position_mm: tuple[float, float]
) -> list[Pose]:
    """Find the poses at which the correlation of projection and scan has another peak than the fit's.

    In each pose the centroid stays at its place in the fit, which `at` and `position_mm` give.
    """
    some = slice(None, None, max(1, len(misfit.angles_rad) // VIEWS))
    angles, turns = hypothesis.rotation.apply(misfit.angles_rad)[some], misfit.table_rad[::2]
    data = misfit.sinogram[some].ravel() - misfit.sinogram[some].mean()
    centroid = complex(*misfit.phantoms[hypothesis.handedness].centroid_mm) + complex(*position_mm)
    poses: list[Pose] = []
    for other, phantom in misfit.phantoms.items():
        places = np.exp(1j * turns) * centroid - complex(*phantom.centroid_mm)
        clear = [analytic.clears(phantom.radius_mm + abs(place), at) for place in places.tolist()]
        # All turns are projected in one call, like views.
        where = np.repeat(places[clear], angles.size)
        views = np.add.outer(turns[clear], angles).ravel()
        model = analytic.project(phantom, misfit.cells, at, views, position_mm=np.stack([where.real, where.imag], -1))
        model = model.reshape(-1, data.size)
        model -= model.mean(axis=1, keepdims=True)
        spread = np.linalg.norm(model, axis=1) * np.linalg.norm(data)
        correlation = np.full(turns.size, -1.0)
        # A pose that casts no shadow in any view has no correlation.
        correlation[clear] = np.divide(
            np.einsum("tm,m->t", model, data), spread, out=np.full(spread.size, -1.0), where=spread > 0.0
        )
        peak = (correlation > np.roll(correlation, 1)) & (correlation >= np.roll(correlation, -1))
        if other is hypothesis.handedness:
            peak &= np.abs(np.angle(np.exp(1j * turns))) > OWN_PEAK
        best = sorted(np.flatnonzero(peak), key=lambda index: -correlation[index])[:PEAKS]
        for index in best:
            frame = replace(at, psi_rad=wrap_angle(at.psi_rad + float(turns[index])))
            poses.append((other, frame, (places[index].real, places[index].imag)))
    return poses
