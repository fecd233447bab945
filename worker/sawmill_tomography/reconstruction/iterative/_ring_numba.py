"""Kernels of the directions across growth rings: the pith's score, and the directions of rings and of an image."""

import math

import numpy as np
from numba import njit, prange

_FAST = {"contract", "nsz", "reassoc", "nnan", "ninf"}


@njit(inline="always")
def _normal(dx, dy, ex, ey, radius):
    """Return the normal of the ring through (dx, dy) from the outline's centre, the pith being at (ex, ey).

    A ring with the share s of the outline's radius has its centre at (1 - s) (ex, ey).
    """
    px, py = dx - ex, dy - ey
    a, b = radius * radius - ex * ex - ey * ey, px * ex + py * ey
    share = (b + math.sqrt(b * b + a * (px * px + py * py))) / a
    return px + share * ex, py + share * ey


@njit(parallel=True, cache=True, fastmath=_FAST)
def score(across, weights, low, pixel, centres, radii, shifts, width, out):
    """Fill out (slices, candidates) with the weighted number of pixels whose gradient is along the rings' normals.

    across (slices, 2, n, n) are unit gradients, weights (slices, n, n); centres (slices, 2) and radii (slices,) those
    of the outlines, shifts (candidates, 2) the pith's place in radii; width is the sine of the angle that counts half.
    """
    slices, n, _ = weights.shape
    candidates = len(shifts)
    one, inverse = np.float32(1.0), np.float32(0.41421356 / width**2)
    least = np.float32(4.0 * pixel * pixel)
    for task in prange(slices * candidates):
        s, k = np.int64(task) // candidates, np.int64(task) % candidates
        radius = np.float32(radii[s])
        ex, ey = radius * np.float32(shifts[k, 0]), radius * np.float32(shifts[k, 1])
        y0, h = np.float32(low[1] + 0.5 * pixel - centres[s, 1]), np.float32(pixel)
        total = 0.0
        for i in range(n):
            dx = np.float32(low[0] + (i + 0.5) * pixel - centres[s, 0])
            row = np.float32(0.0)
            for j in range(n):
                u, v = _normal(dx, y0 + j * h, ex, ey, radius)
                sine = across[s, 0, i, j] * v - across[s, 1, i, j] * u
                ratio = one + sine * sine / (u * u + v * v + least) * inverse
                row += weights[s, i, j] / (ratio * ratio)
            total += row
        out[s, k] = total


@njit(parallel=True, cache=True, fastmath=_FAST)
def directions(tensor, low, pixel, centres, radii, piths, prior, out):
    """Fill out (slices, 2, n, n) with unit vectors across the structures of an image or, where it has none, the rings.

    tensor (slices, 3, n, n) is the structure tensor xx, xy, yy, to which prior times the rings' tensor is added. At the
    pith, piths (slices, 2) in radii, the vectors' length falls to 0.
    """
    slices, n = len(out), out.shape[-1]
    for task in prange(slices * n):
        s, i = np.int64(task) // n, np.int64(task) % n
        ex, ey = radii[s] * piths[s, 0], radii[s] * piths[s, 1]
        dx = low[0] + (i + 0.5) * pixel - centres[s, 0]
        for j in range(n):
            u, v = _normal(dx, low[1] + (j + 0.5) * pixel - centres[s, 1], ex, ey, radii[s])
            square = u * u + v * v
            near = min(math.sqrt(square) / (2.0 * pixel), 1.0)
            factor = prior * near / (square + 1e-12)
            even = tensor[s, 0, i, j] - tensor[s, 2, i, j] + factor * (u * u - v * v)
            odd = 2.0 * (tensor[s, 1, i, j] + factor * u * v)
            # The eigenvector of the larger eigenvalue, by the half angle.
            angle = 0.5 * math.atan2(odd, even)
            out[s, 0, i, j], out[s, 1, i, j] = near * math.cos(angle), near * math.sin(angle)
