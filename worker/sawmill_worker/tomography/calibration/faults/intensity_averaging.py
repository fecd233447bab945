"""A cell of counts averages intensities over its rays, where the model averages paths."""

from dataclasses import replace

import numpy as np

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.analytic import DetectorCells
from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, Finding
from sawmill_worker.tomography.calibration.fit import Fit
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.vocabulary import Adjustment

# Rays over which a cell's intensities are averaged.
FINE_RAYS = 8
ROUNDS = 2


def _adjust(now: AdjustedFit) -> AdjustedFit:
    """Add the difference to the sinogram, from the fit itself, and repeat the fit, twice.

    Without it, edges along the rays would pull the geometry.
    """
    if not now.from_counts or now.data.rays_per_cell == 1:  # a cell of one ray averages nothing
        return now
    data, fit = now.data, now.fit
    for _ in range(ROUNDS):
        data = replace(now.data, sinogram=now.data.sinogram + _difference(now, fit))
        again = now.refitted(data, fit)
        if again is None:
            return now
        fit = again
    return now.after(data, fit, "each cell's averaging of intensities was allowed for")


def _difference(now: AdjustedFit, fit: Fit) -> FloatArray:
    """mean(p) + ln(mean(exp(-p))) over each cell's rays, (views, cells)."""
    cells = now.data.cells
    fine = DetectorCells(cells.first_border_mm, cells.width_mm / FINE_RAYS, cells.count * FINE_RAYS)
    rays = analytic.project(
        now.phantom, fine, fit.frame, now.data.angles_rad, position_mm=fit.position_mm, rays_per_cell=1
    ).reshape(len(now.data.sinogram), cells.count, FINE_RAYS)
    rays *= fit.gain
    difference: FloatArray = rays.mean(axis=2) + np.log(np.exp(-rays).mean(axis=2))
    return difference


INTENSITY_AVERAGING = Finding(Adjustment.INTENSITY_AVERAGING, _adjust)
