"""Kernels of the edge-preserving priors: value and gradient over the differences to the next pixel along x and y."""

import math

import numpy as np
from numba import njit, prange

_FAST = {"contract", "nsz", "reassoc", "nnan", "ninf"}
# Rows of an image that one thread takes at a time.
BAND = 16
# Factors that are multiplied before one logarithm is taken: each is below 1e35, so their product stays finite.
TOGETHER = 8


@njit(inline="always")
def _ratios(x, row, n, inverse, out):
    """Compute 1 + (d_x^2 + d_y^2) / scale^2 along one row, padded with ones to whole groups."""
    for j in range(n - 1):
        a, b = x[row + 1, j] - x[row, j], x[row, j + 1] - x[row, j]
        out[j] = np.float32(1.0) + (a * a + b * b) * inverse
    for j in range(n - 1, out.size):
        out[j] = np.float32(1.0)


@njit(inline="always")
def _add_gradient(x, i, n, weight, here, before, g):
    """Add to row i the gradient of the differences that start or end in it, each times its factor."""
    if i < n - 1:
        for j in range(n - 1):
            g[i, j] -= weight * (x[i + 1, j] + x[i, j + 1] - np.float32(2.0) * x[i, j]) * here[j]
        for j in range(n - 1):
            g[i, j + 1] += weight * (x[i, j + 1] - x[i, j]) * here[j]
    if i > 0:
        for j in range(n - 1):
            g[i, j] += weight * (x[i, j] - x[i - 1, j]) * before[j]


@njit(parallel=True, cache=True, fastmath=_FAST)
def cauchy(images, scales, strengths, gradient, values):
    """Add the gradient of strength * sum log(1 + (d_x^2 + d_y^2) / scale^2) to gradient; set values (images, bands).

    images and gradient are (images, n, n); scales and strengths (images,).
    """
    count, n, _ = images.shape
    bands = values.shape[1]
    for task in prange(count * bands):
        s, band = np.int64(task) // bands, np.int64(task) % bands
        x, g = images[s], gradient[s]
        inverse = np.float32(1.0 / scales[s] ** 2)
        weight = np.float32(2.0 * strengths[s] / scales[s] ** 2)
        before = np.ones((n - 1 + TOGETHER) // TOGETHER * TOGETHER, np.float32)
        here = np.ones_like(before)
        first, last = band * BAND, min((band + 1) * BAND, n)
        if first > 0:
            _ratios(x, first - 1, n, inverse, before)
            for j in range(before.size):
                before[j] = np.float32(1.0) / before[j]
        total = 0.0
        for i in range(first, last):
            if i < n - 1:
                _ratios(x, i, n, inverse, here)
                for group in range(0, here.size, TOGETHER):
                    product = 1.0
                    for q in range(TOGETHER):
                        product *= here[group + q]
                    total += math.log(product)
                for j in range(here.size):
                    here[j] = np.float32(1.0) / here[j]
            _add_gradient(x, i, n, weight, here, before, g)
            before, here = here, before
        values[s, band] = strengths[s] * total


@njit(parallel=True, cache=True, fastmath=_FAST)
def total_variation(images, scales, strengths, gradient, values):
    """Do the work of `cauchy` for strength * scale * sum (sqrt(1 + (d_x^2 + d_y^2) / scale^2) - 1)."""
    count, n, _ = images.shape
    bands = values.shape[1]
    for task in prange(count * bands):
        s, band = np.int64(task) // bands, np.int64(task) % bands
        x, g = images[s], gradient[s]
        inverse = np.float32(1.0 / scales[s] ** 2)
        weight = np.float32(strengths[s] / scales[s])
        before, here = np.ones(n, np.float32), np.ones(n, np.float32)
        first, last = band * BAND, min((band + 1) * BAND, n)
        if first > 0:
            _ratios(x, first - 1, n, inverse, before)
            for j in range(n):
                before[j] = np.float32(1.0) / math.sqrt(before[j])
        total = 0.0
        for i in range(first, last):
            if i < n - 1:
                _ratios(x, i, n, inverse, here)
                for j in range(n):
                    factor = np.float32(1.0) / math.sqrt(here[j])
                    total += here[j] * factor - np.float32(1.0)
                    here[j] = factor
            _add_gradient(x, i, n, weight, here, before, g)
            before, here = here, before
        values[s, band] = strengths[s] * scales[s] * total


@njit(inline="always")
def _ring_row(x, row, n, inverse, share, r, p, q):
    """Fill p and q with the root's slopes along x and y in one row; return the sum of the roots, each less 1."""
    one, total = np.float32(1.0), 0.0
    for j in range(n - 1):
        a, b = x[row + 1, j] - x[row, j], x[row, j + 1] - x[row, j]
        across = r[0, row, j] * a + r[1, row, j] * b
        inner = share * across
        root = math.sqrt(one + (a * a + b * b - inner * across) * inverse)
        total += root - one
        p[j] = (a - inner * r[0, row, j]) / root
        q[j] = (b - inner * r[1, row, j]) / root
    return total


@njit(parallel=True, cache=True, fastmath=_FAST)
def ring_variation(images, scales, strengths, shares, directions, which, gradient, values):
    """Do the work of `total_variation` with |d|^2 - share (r . d)^2 in place of |d|^2.

    shares are (images,); directions (fields, 2, n, n) hold r, one field for each problem or one for all.
    """
    count, n, _ = images.shape
    bands = values.shape[1]
    for task in prange(count * bands):
        s, band = np.int64(task) // bands, np.int64(task) % bands
        x, g, r = images[s], gradient[s], directions[min(which[s], len(directions) - 1)]
        inverse, share = np.float32(1.0 / scales[s] ** 2), np.float32(shares[s])
        weight = np.float32(strengths[s] / scales[s])
        before, here, along = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
        first, last = band * BAND, min((band + 1) * BAND, n)
        if first > 0:
            _ring_row(x, first - 1, n, inverse, share, r, before, along)
        total = 0.0
        for i in range(first, last):
            if i < n - 1:
                total += _ring_row(x, i, n, inverse, share, r, here, along)
                for j in range(n - 1):
                    g[i, j] -= weight * (here[j] + along[j])
                for j in range(n - 1):
                    g[i, j + 1] += weight * along[j]
            for j in range(n - 1):
                g[i, j] += weight * before[j]
            before, here = here, before
        values[s, band] = strengths[s] * scales[s] * total


@njit(parallel=True, cache=True, fastmath=_FAST)
def ring_scaling(images, scales, stiffest, data, shares, directions, which, out):
    """Do the work of `scaling` for `ring_variation`."""
    count, n, _ = images.shape
    one = np.float32(1.0)
    for ss in prange(count):
        s = np.int64(ss)
        x, g, r = images[s], out[s], directions[min(which[s], len(directions) - 1)]
        inverse, stiff, share = np.float32(1.0 / scales[s] ** 2), np.float32(stiffest[s]), np.float32(shares[s])
        rest, flat = np.float32(data[s]), np.float32(data[s] + 4.0 * stiffest[s])
        g[:] = rest
        for i in range(n - 1):
            for j in range(n - 1):
                a, b, u, v = x[i + 1, j] - x[i, j], x[i, j + 1] - x[i, j], r[0, i, j], r[1, i, j]
                across = u * a + v * b
                here = stiff / math.sqrt(one + (a * a + b * b - share * across * across) * inverse)
                g[i, j] += here * (np.float32(2.0) - share * (u + v) * (u + v))
                g[i + 1, j] += here * (one - share * u * u)
                g[i, j + 1] += here * (one - share * v * v)
        for i in range(n):
            for j in range(n):
                g[i, j] = math.sqrt(flat / g[i, j])


@njit(parallel=True, cache=True, fastmath=_FAST)
def scaling(images, scales, stiffest, data, power, out):
    """Fill out with sqrt((data + 4 stiffest) / (data + diagonal)), the diagonal of the prior's reweighted quadratic.

    A difference d is as stiff as stiffest * (1 + |d|^2 / scale^2)^-power, power 1 or 1/2; scales, stiffest and data are
    (images,).
    """
    count, n, _ = images.shape
    for ss in prange(count):
        s = np.int64(ss)
        x, g = images[s], out[s]
        inverse, stiff = np.float32(1.0 / scales[s] ** 2), np.float32(stiffest[s])
        rest, flat = np.float32(data[s]), np.float32(data[s] + 4.0 * stiffest[s])
        g[:] = rest
        for i in range(n - 1):
            for j in range(n - 1):
                a, b = x[i + 1, j] - x[i, j], x[i, j + 1] - x[i, j]
                ratio = np.float32(1.0) + (a * a + b * b) * inverse
                here = stiff / (ratio if power == 1.0 else math.sqrt(ratio))
                g[i, j] += np.float32(2.0) * here
                g[i + 1, j] += here
                g[i, j + 1] += here
        for i in range(n):
            for j in range(n):
                g[i, j] = math.sqrt(flat / g[i, j])


@njit(parallel=True, cache=True, fastmath=_FAST)
def axial(images, scales, strengths, gradient, values):
    """Add the gradient of sum strength * scale * (sqrt(1 + d^2 / scale^2) - 1) to gradient; set values (slices - 1, n).

    images and gradient are (slices, n, n); d is the difference of slice k + 1 and slice k, scales and strengths
    (slices - 1,).
    """
    slices, n, _ = images.shape
    for ii in prange(n):
        i = np.int64(ii)
        for k in range(slices - 1):
            here, there, g, h = images[k, i], images[k + 1, i], gradient[k, i], gradient[k + 1, i]
            inverse = np.float32(1.0 / scales[k] ** 2)
            weight = np.float32(strengths[k] / scales[k])
            total = np.float32(0.0)
            for j in range(n):
                d = there[j] - here[j]
                root = math.sqrt(np.float32(1.0) + d * d * inverse)
                slope = weight * d / root
                total += root - np.float32(1.0)
                g[j] -= slope
                h[j] += slope
            values[k, i] = strengths[k] * scales[k] * total


@njit(parallel=True, cache=True, fastmath=_FAST)
def stiffen(images, scales, strengths, flat, softness):
    """Lower softness (slices, n, n) in place by the stiffness of the differences along the axis (`axial`).

    softness is sqrt(flat / stiffness) with flat (slices,), the result of `scaling`; strength / scale / root of each
    difference is added to the stiffness of both pixels.
    """
    slices, n, _ = images.shape
    one = np.float32(1.0)
    for ii in prange(n):
        i = np.int64(ii)
        below, above = np.zeros(n, np.float32), np.zeros(n, np.float32)
        for k in range(slices):
            if k < slices - 1:
                here, there = images[k, i], images[k + 1, i]
                inverse = np.float32(1.0 / scales[k] ** 2)
                weight = np.float32(strengths[k] / scales[k])
                for j in range(n):
                    d = there[j] - here[j]
                    above[j] = weight / math.sqrt(one + d * d * inverse)
            else:
                above[:] = np.float32(0.0)
            soft, share = softness[k, i], np.float32(1.0 / flat[k])
            for j in range(n):
                soft[j] /= math.sqrt(one + (below[j] + above[j]) * soft[j] * soft[j] * share)
            below, above = above, below
