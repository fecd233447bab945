"""Kernel of the search for metal: the rays through each point of a grid."""

import math

import numpy as np
from numba import njit


@njit(cache=True, fastmath={"reassoc", "contract", "nsz", "arcp"})
def back_projected(residual, turns, points, frame, first_border, width, clipped, mean):
    """The mean over the views of the clipped residual at the ray through each point.

    residual (views, cells) float32; turns (views,): the view's angle plus psi; points (points, 2) mm; frame: R, SDD,
    u_c, cos tau, sin tau. A ray beside the detector counts as zero. Fills mean (points,).
    """
    views, cells = residual.shape
    cosines, sines = np.cos(turns), np.sin(turns)
    for p in range(points.shape[0]):
        total = 0.0
        for k in range(views):
            x = cosines[k] * points[p, 0] + sines[k] * points[p, 1]
            y = cosines[k] * points[p, 1] - sines[k] * points[p, 0]
            u = frame[2] + frame[1] * x / ((y + frame[0]) * frame[3] - x * frame[4])
            cell = math.floor((u - first_border) / width)
            if 0 <= cell < cells:
                total += min(max(residual[k, cell], -clipped), clipped)
        mean[p] = total / views
