"""Kernels of the ray-driven projector: exact intersection lengths of rays with pixels, and their transpose.

A ray is marched slab by slab along the axis it mostly follows; in each slab it touches at most two pixels, and its
length there is shared between them where it crosses their border. Rays along y read image[x, y], rays along x read
the transposed image, so that the march is contiguous in memory either way.
"""

import math

import numpy as np
from numba import njit, prange

_FAST = {"contract", "nsz"}


@njit(inline="always")
def _ray(sx, sy, px, py, half, pixel):
    """The ray S -> P as (march along y?, position at slab 0's border, step per slab, length per slab), in pixels."""
    dx, dy = px - sx, py - sy
    along_y = abs(dy) >= abs(dx)
    if along_y:
        slope = dx / dy
        start = (sx + (-half - sy) * slope + half) / pixel
    else:
        slope = dy / dx
        start = (sy + (-half - sx) * slope + half) / pixel
    return along_y, start, slope, pixel * math.sqrt(1.0 + slope * slope)


@njit(inline="always")
def _slabs(start, slope, n):
    """The slabs first..last in which the ray can touch the image."""
    if slope == 0.0:
        inside = 0.0 <= start < n
        return (0, n) if inside else (0, 0)
    a = -start / slope
    b = (n - start) / slope
    low, high = min(a, b), max(a, b)
    first = max(0, int(math.floor(max(low, -1.0))))
    last = min(n, int(math.ceil(min(high, n + 1.0))))
    return first, last


@njit(parallel=True, cache=True, fastmath=_FAST)
def forward(image, image_t, source, centre, axis, pitch, half, pixel, out):
    """Fill out (views, cells) with line integrals of image [x, y]."""
    views, cells = out.shape
    n = image.shape[0]
    for kk in prange(views):
        k = np.int64(kk)
        for m in range(cells):
            u = (m + 0.5 - 0.5 * cells) * pitch
            along_y, start, slope, length = _ray(
                source[k, 0], source[k, 1], centre[k, 0] + u * axis[k, 0], centre[k, 1] + u * axis[k, 1], half, pixel
            )
            first, last = _slabs(start, slope, n)
            total = 0.0
            for j in range(first, last):
                a = start + j * slope
                b = a + slope
                ia, ib = int(math.floor(a)), int(math.floor(b))
                share = 1.0
                if ia != ib:
                    share = (max(ia, ib) - a) / slope
                if 0 <= ia < n:
                    total += share * (image[ia, j] if along_y else image_t[ia, j])
                if ia != ib and 0 <= ib < n:
                    total += (1.0 - share) * (image[ib, j] if along_y else image_t[ib, j])
            out[k, m] = length * total


@njit(parallel=True, cache=True, fastmath=_FAST)
def adjoint(sinogram, source, centre, axis, pitch, half, pixel, threads, out):
    """Fill out [x, y] with the transpose of `forward`; each of the threads sums into images of its own."""
    views, cells = sinogram.shape
    n = out.shape[0]
    upright = np.zeros((threads, n, n), np.float32)
    turned = np.zeros((threads, n, n), np.float32)
    for tt in prange(threads):
        t = np.int64(tt)
        for k in range(t * views // threads, (t + 1) * views // threads):
            for m in range(cells):
                u = (m + 0.5 - 0.5 * cells) * pitch
                along_y, start, slope, length = _ray(
                    source[k, 0],
                    source[k, 1],
                    centre[k, 0] + u * axis[k, 0],
                    centre[k, 1] + u * axis[k, 1],
                    half,
                    pixel,
                )
                first, last = _slabs(start, slope, n)
                value = length * sinogram[k, m]
                for j in range(first, last):
                    a = start + j * slope
                    b = a + slope
                    ia, ib = int(math.floor(a)), int(math.floor(b))
                    share = 1.0
                    if ia != ib:
                        share = (max(ia, ib) - a) / slope
                    if 0 <= ia < n:
                        if along_y:
                            upright[t, ia, j] += share * value
                        else:
                            turned[t, ia, j] += share * value
                    if ia != ib and 0 <= ib < n:
                        if along_y:
                            upright[t, ib, j] += (1.0 - share) * value
                        else:
                            turned[t, ib, j] += (1.0 - share) * value
    for ii in prange(n):
        i = np.int64(ii)
        for j in range(n):
            total = np.float32(0.0)
            for t in range(threads):
                total += upright[t, i, j] + turned[t, j, i]
            out[i, j] = total
