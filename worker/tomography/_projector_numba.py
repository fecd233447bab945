"""Kernels of the ray-driven projector: exact intersection lengths of rays with pixels, and their transpose.

A ray is marched slab by slab along the axis it mostly follows; in each slab it touches at most two pixels, and its
length there is shared between them where it crosses their border. The march first writes down where each pair of
pixels lies and the two lengths (a long flat loop of arithmetic), then reads or adds to the pixels.

Images have a border of pixels beyond the field, one before and two behind, so that a pair half outside needs no test.
Blocks of slices have the slice axis innermost: one table of lengths serves them all.
"""

import math

import numpy as np
from numba import njit, prange

# The summation order is free; positions and lengths are in double precision.
_FAST = {"contract", "nsz", "reassoc"}
BORDER = 3


@njit(inline="always")
def _march(sx, sy, px, py, half, pixel, lanes, n, where, near, far):
    """Tabulate the ray S -> P: each slab's near pixel and the lengths in both; returns how many, and the far's step."""
    dx, dy = px - sx, py - sy
    along_y = abs(dy) >= abs(dx)
    if along_y:
        slope = dx / dy
        start = (sx + (-half - sy) * slope + half) / pixel
    else:
        slope = dy / dx
        start = (sy + (-half - sx) * slope + half) / pixel
    first, last = _slabs(start, slope, n)
    length = pixel * math.sqrt(1.0 + slope * slope)
    # The ray's lower end in the first slab, in pixels, counted from the border.
    lowest = start + min(slope, 0.0) + 1.0 + first * slope
    per_pixel = length / max(abs(slope), 1e-30)
    row, column = np.uint32((n + BORDER) * lanes), np.uint32(lanes)
    step = row if along_y else column
    onward = column if along_y else row
    begin = np.uint32(first + 1) * onward
    count = np.uint32(max(last - first, 0))
    for j in range(count):
        low = lowest + j * slope
        i = np.int32(low)
        share = min(length, (i + 1.0 - low) * per_pixel)
        where[j] = np.uint32(i) * step + np.uint32(j) * onward + begin
        near[j] = share
        far[j] = length - share
    return count, step


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
def forward(image, n, source, centre, axis, pitch, half, pixel, out):
    """Fill out (views, cells) with line integrals of a bordered image [x, y], flat."""
    views, cells = out.shape
    for kk in prange(views):
        k = np.int64(kk)
        where, near, far = np.empty(n, np.uint32), np.empty(n, np.float32), np.empty(n, np.float32)
        for m in range(cells):
            u = (m + 0.5 - 0.5 * cells) * pitch
            px, py = centre[k, 0] + u * axis[k, 0], centre[k, 1] + u * axis[k, 1]
            count, step = _march(source[k, 0], source[k, 1], px, py, half, pixel, 1, n, where, near, far)
            total = 0.0
            for j in range(count):
                p = where[j]
                total += near[j] * image[p] + far[j] * image[p + step]
            out[k, m] = total


@njit(parallel=True, cache=True, fastmath=_FAST)
def adjoint(sinogram, n, source, centre, axis, pitch, half, pixel, work, out):
    """Fill out [x, y] with the transpose of `forward`; each thread sums into a row of work of its own."""
    views, cells = sinogram.shape
    threads = work.shape[0]
    for tt in prange(threads):
        t = np.int64(tt)
        where, near, far = np.empty(n, np.uint32), np.empty(n, np.float32), np.empty(n, np.float32)
        image = work[t]
        image[:] = np.float32(0.0)
        for k in range(t * views // threads, (t + 1) * views // threads):
            for m in range(cells):
                u = (m + 0.5 - 0.5 * cells) * pitch
                px, py = centre[k, 0] + u * axis[k, 0], centre[k, 1] + u * axis[k, 1]
                count, step = _march(source[k, 0], source[k, 1], px, py, half, pixel, 1, n, where, near, far)
                value = sinogram[k, m]
                for j in range(count):
                    p = where[j]
                    image[p] += near[j] * value
                    image[p + step] += far[j] * value
    for ii in prange(n):
        i = np.int64(ii)
        for j in range(n):
            total = np.float32(0.0)
            for t in range(threads):
                total += work[t, (i + 1) * (n + BORDER) + j + 1]
            out[i, j] = total


@njit(parallel=True, cache=True, fastmath=_FAST)
def forward_block(images, n, source, centre, axis, pitch, half, pixel, out):
    """Fill out (views, cells, slices) with line integrals of a bordered block [x, y, slice], flat."""
    views, cells, slices = out.shape
    for kk in prange(views):
        k = np.int64(kk)
        where, near, far = np.empty(n + 1, np.uint32), np.empty(n + 1, np.float32), np.empty(n + 1, np.float32)
        total = np.empty(slices, np.float32)
        for m in range(cells):
            u = (m + 0.5 - 0.5 * cells) * pitch
            px, py = centre[k, 0] + u * axis[k, 0], centre[k, 1] + u * axis[k, 1]
            count, step = _march(source[k, 0], source[k, 1], px, py, half, pixel, slices, n, where, near, far)
            # Two slabs at a time: the sums are fetched and stored half as often. A last odd one gets an empty partner.
            where[count], near[count], far[count] = 0, 0.0, 0.0
            total[:] = np.float32(0.0)
            for j in range(np.uint32(0), count, np.uint32(2)):
                p, q = where[j], where[j + 1]
                a, b, c, d = near[j], far[j], near[j + 1], far[j + 1]
                for s in range(np.uint32(slices)):
                    total[s] += (a * images[p + s] + b * images[p + step + s]) + (
                        c * images[q + s] + d * images[q + step + s]
                    )
            out[k, m, :] = total


@njit(parallel=True, cache=True, fastmath=_FAST)
def adjoint_block(sinograms, n, source, centre, axis, pitch, half, pixel, work, out):
    """Fill out [slice, x, y] with the transpose of `forward_block`; threads sum into rows of work of their own."""
    views, cells, slices = sinograms.shape
    threads = work.shape[0]
    for tt in prange(threads):
        t = np.int64(tt)
        where, near, far = np.empty(n, np.uint32), np.empty(n, np.float32), np.empty(n, np.float32)
        value = np.empty(slices, np.float32)
        images = work[t]
        images[:] = np.float32(0.0)
        for k in range(t * views // threads, (t + 1) * views // threads):
            for m in range(cells):
                u = (m + 0.5 - 0.5 * cells) * pitch
                px, py = centre[k, 0] + u * axis[k, 0], centre[k, 1] + u * axis[k, 1]
                count, step = _march(source[k, 0], source[k, 1], px, py, half, pixel, slices, n, where, near, far)
                value[:] = sinograms[k, m]
                for j in range(count):
                    p = where[j]
                    # One loop a pixel: two pixels in one loop could be the same memory, for all the compiler knows.
                    for s in range(np.uint32(slices)):
                        images[p + s] += near[j] * value[s]
                    p += step
                    for s in range(np.uint32(slices)):
                        images[p + s] += far[j] * value[s]
    for ii in prange(n):
        i = np.int64(ii)
        for j in range(n):
            at = ((i + 1) * (n + BORDER) + j + 1) * slices
            for s in range(slices):
                total = np.float32(0.0)
                for t in range(threads):
                    total += work[t, at + s]
                out[s, i, j] = total
