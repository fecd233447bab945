"""Kernel of the back-projection. Symbols are those of the source frame (section 3 of the design page)."""

import math

import numpy as np
from numba import njit, prange


@njit(parallel=True, cache=True, fastmath={"contract", "nsz", "arcp", "reassoc"})
def back_project(rows, beta, big_r, sdd, u_c, tau, pitch, half, pixel, power, out):
    """Sum over the views of rows (views, cells + 2) at u(x, k), over (n.(x - S))**power, into out [x, y].

    rows carry one zero cell at either end: what the detector does not see adds nothing.
    """
    views, padded = rows.shape
    size = out.shape[0]
    c_tau, s_tau = math.cos(tau), math.sin(tau)
    scale = np.float32(sdd / pitch)
    # Cell m is centred at (m + 1/2 - n/2) pitch and stands at index m + 1 of the padded row.
    offset = np.float32(u_c / pitch + 0.5 * (padded - 2) + 0.5)
    top = np.float32(padded - 1.001)
    zero = np.float32(0.0)
    one = np.float32(1.0)
    for ii in prange(size):
        i = np.int64(ii)
        x = -half + (i + 0.5) * pixel
        y = -half + 0.5 * pixel
        line = np.zeros(size, np.float32)
        for k in range(views):
            c, s = math.cos(beta[k]), math.sin(beta[k])
            # q = Rot(-beta) (x, y) + (0, R), its x component and its component along the detector normal.
            qx = c * x + s * y
            qy = c * y - s * x + big_r
            across = np.float32(qx)
            depth = np.float32(qy * c_tau - qx * s_tau)
            across_step = np.float32(s * pixel)
            depth_step = np.float32((c * c_tau - s * s_tau) * pixel)
            row = rows[k]
            for j in range(size):
                step = np.float32(j)
                inverse = one / (depth + step * depth_step)
                t = (across + step * across_step) * inverse * scale + offset
                t = min(max(t, zero), top)
                cell = np.uint32(t)
                fraction = t - np.float32(cell)
                value = row[cell] + fraction * (row[cell + np.uint32(1)] - row[cell])
                line[j] += value * inverse * (inverse if power == 2 else one)
        for j in range(size):
            out[i, j] = line[j]
