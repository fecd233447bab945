"""COR and tilt of a full turn by opposite rays, with no code of the product: what `measured.py` compares it with.

Over a full turn every ray is measured from either end, p(phi, gamma) = p(phi + pi - 2 gamma, -gamma), with the fan
angle gamma of docs/look-up/conventions.md#source-frame. Least squares over (u_c, tau) at a given SDD, cubic splines
between views and cells, standard deviations by leaving out each of twelve stretches of the turn (jackknife).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter1d
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]

STRETCHES = 12
# Cells at the detector's ends, where a spline has no neighbours.
ENDS = 4


@dataclass(frozen=True)
class Independent:
    """COR on the detector and tilt of one scan, with their standard deviations."""

    cor_column_mm: float
    cor_column_sd_mm: float
    tilt_deg: float
    tilt_sd_deg: float


def opposite_ray_fit(sinogram: FloatArray, *, pitch_mm: float, source_to_detector_mm: float) -> Independent:
    """Fit (u_c, tau) to a full turn of equal steps; sinogram is (views, cells), angles increase."""
    views, cells = sinogram.shape
    middle = (cells - 1) / 2
    u = (np.arange(cells) - middle) * pitch_mm
    along_views = spline_filter1d(sinogram, 3, 0, mode="grid-wrap")
    spline = spline_filter1d(along_views, 3, 1, mode="mirror")

    def differences(parameters: FloatArray) -> FloatArray:
        u_c, tau = parameters
        cos, sin = math.cos(tau), math.sin(tau)
        gamma = np.arctan2((u - u_c) * cos, source_to_detector_mm + (u - u_c) * sin)
        slope = np.tan(-gamma)
        cell = (u_c + source_to_detector_mm * slope / (cos - slope * sin)) / pitch_mm + middle
        view = np.arange(views)[:, None] + (math.pi - 2.0 * gamma) * views / math.tau
        at = [view, np.broadcast_to(cell, view.shape)]
        opposite = map_coordinates(spline, at, order=3, prefilter=False, mode="grid-wrap")
        inside = (cell > ENDS) & (cell < cells - 1 - ENDS)
        return np.ravel((sinogram - opposite) * inside)

    solved = least_squares(differences, np.zeros(2), x_scale=(0.01, 0.001))
    # The estimate without a stretch is one step of Gauss and Newton away from the whole turn's estimate.
    stretches = [
        (jacobian.T @ jacobian, jacobian.T @ residual)
        for jacobian, residual in zip(
            np.array_split(solved.jac, STRETCHES), np.array_split(solved.fun, STRETCHES), strict=True
        )
    ]
    normal, gradient = (sum(parts) for parts in zip(*stretches, strict=True))
    without = np.array([np.linalg.solve(normal - n, g - gradient) for n, g in stretches])
    deviation = np.sqrt((STRETCHES - 1) * without.var(axis=0))
    return Independent(
        cor_column_mm=round(float(solved.x[0]), 4),
        cor_column_sd_mm=round(float(deviation[0]), 4),
        tilt_deg=round(math.degrees(solved.x[1]), 3),
        tilt_sd_deg=round(math.degrees(deviation[1]), 3),
    )
