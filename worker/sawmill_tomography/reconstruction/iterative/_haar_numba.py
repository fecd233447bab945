"""Kernels of one step of the orthonormal Haar transform of images: (slices, n, n), n even."""

import numpy as np
from numba import njit, prange

_FAST = {"contract", "nsz", "reassoc", "nnan", "ninf"}


@njit(parallel=True, cache=True, fastmath=_FAST)
def means(images, out):
    """Fill out (slices, n / 2, n / 2) with half the sum of every four pixels."""
    slices, m, _ = out.shape
    half = np.float32(0.5)
    for task in prange(slices * m):
        s, i = np.int64(task) // m, np.int64(task) % m
        one, other, mean = images[s, 2 * i], images[s, 2 * i + 1], out[s, i]
        for j in range(m):
            mean[j] = half * (one[2 * j] + one[2 * j + 1] + other[2 * j] + other[2 * j + 1])


@njit(parallel=True, cache=True, fastmath=_FAST)
def join(images, mean, straight, diagonal, out):
    """Fill out with images in which every four pixels get a new mean and multiplied differences from it.

    mean is the result of `means`; straight and diagonal (slices,) are the factors of the differences along x or y, and
    of the differences along both.
    """
    slices, m, _ = mean.shape
    quarter, half = np.float32(0.25), np.float32(0.5)
    for task in prange(slices * m):
        s, i = np.int64(task) // m, np.int64(task) % m
        one, other, new_mean = images[s, 2 * i], images[s, 2 * i + 1], mean[s, i]
        new_one, new_other = out[s, 2 * i], out[s, 2 * i + 1]
        edge, corner = quarter * np.float32(straight[s]), quarter * np.float32(diagonal[s])
        for j in range(m):
            a, b, c, d = one[2 * j], one[2 * j + 1], other[2 * j], other[2 * j + 1]
            level = half * new_mean[j]
            x, y, xy = edge * (a + b - c - d), edge * (a - b + c - d), corner * (a - b - c + d)
            new_one[2 * j], new_one[2 * j + 1] = level + x + y + xy, level + x - y - xy
            new_other[2 * j], new_other[2 * j + 1] = level - x + y - xy, level - x - y + xy
