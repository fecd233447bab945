"""Kernels of the ray-driven projector: exact intersection lengths of rays with pixels, and their transpose.

A ray is marched slab by slab along the axis that it mostly follows; in each slab it touches at most two pixels, and its
length there is shared between them where it crosses their border. The march first tabulates the position of each pair
of pixels and the two lengths (a long flat loop of arithmetic), then reads or adds to the pixels.

Images are interleaved, innermost in memory: the lanes, for which one table of lengths serves. A lane is a slice, or a
quarter turn of it where the views repeat after a quarter turn: lane s * turns + q is slice s as the q-th quarter of the
views sees it. A block (n + 3, n + 3, lanes) has a border of pixels beyond the field, one before and two behind, so that
a pair half outside needs no test.
"""

import math

import numpy as np
from numba import njit, prange

from sawmill_tomography.projection import _lanes_numba as vector

# The summation order is free; positions are in double precision from group to group of slabs.
_FAST = {"contract", "nsz", "reassoc"}
BORDER = 3
# Slabs tabulated together, and cells of a view whose rays a thread takes at a time.
_GROUP = 16
_CELLS = 64
# Columns of the table of a view's rays. The length per pixel is kept in memory, or the compiler would divide by the
# slope in every slab.
_LOWEST, _SLOPE, _LENGTH, _PER_PIXEL, _FIRST, _COUNT, _ALONG_Y = range(7)


@njit(inline="always")
def _tabulate_rays(k, start, source, centre, axis, positions, half, pixel, n, rays):
    """Fill rays (7, cells at a time), which `_march` needs, for the rays start.. of view k."""
    sx, sy = source[k, 0], source[k, 1]
    for c in range(rays.shape[1]):
        u = positions[start + c]
        dx, dy = centre[k, 0] + u * axis[k, 0] - sx, centre[k, 1] + u * axis[k, 1] - sy
        along_y = abs(dy) >= abs(dx)
        slope = dx / dy if along_y else dy / dx
        entry = ((sx + (-half - sy) * slope if along_y else sy + (-half - sx) * slope) + half) / pixel
        steep = max(abs(slope), 1e-30)
        # The slabs in which the ray can touch the image; none if it misses the image.
        one, other = -entry / math.copysign(steep, slope), (n - entry) / math.copysign(steep, slope)
        first = math.floor(min(max(0.0, min(one, other)), n))
        last = math.ceil(min(max(0.0, one, other), n))
        rays[_LOWEST, c] = entry + min(slope, 0.0) + 1.0 + first * slope
        rays[_SLOPE, c] = slope
        rays[_LENGTH, c] = pixel * math.sqrt(1.0 + slope * slope)
        rays[_PER_PIXEL, c] = pixel * math.sqrt(1.0 + slope * slope) / steep
        rays[_FIRST, c] = first
        rays[_COUNT, c] = last - first
        rays[_ALONG_Y, c] = 1.0 if along_y else 0.0


@njit(inline="always")
def _march(rays, c, n, where, near, far):
    """Tabulate a ray: near pixels, both lengths; return the slabs, these in whole groups, and the far pixel's step."""
    lowest, slope = rays[_LOWEST, c], rays[_SLOPE, c]
    length, per_pixel, rise = np.float32(rays[_LENGTH, c]), np.float32(rays[_PER_PIXEL, c]), np.float32(slope)
    row, column = np.uint32(n + BORDER), np.uint32(1)
    step, onward = (row, column) if rays[_ALONG_Y, c] == 1.0 else (column, row)
    count = np.uint64(rays[_COUNT, c])
    padded = (count + np.uint64(_GROUP - 1)) // np.uint64(_GROUP) * np.uint64(_GROUP)
    begin = (np.uint32(rays[_FIRST, c]) + np.uint32(1)) * onward
    for group in range(np.uint64(0), padded, np.uint64(_GROUP)):
        # The ray's lower end in the first slab, in pixels, counted from the border; single precision counts from the
        # group's lowest pixel.
        low = lowest + group * slope
        pixel = math.floor(low + min(_GROUP * slope, 0.0))
        within = np.float32(low - pixel)
        at = np.uint32(np.int32(pixel)) * step + np.uint32(group) * onward + begin
        for j in range(np.uint64(_GROUP)):
            here = within + np.float32(np.int32(j)) * rise
            i = np.int32(here)
            share = min(length, (np.float32(i) + np.float32(1.0) - here) * per_pixel)
            where[group + j] = at + np.uint32(i) * step + np.uint32(j) * onward
            near[group + j] = share
            far[group + j] = length - share
    for j in range(count, padded):
        where[j], near[j], far[j] = 0, 0.0, 0.0
    return count, padded, np.uint64(step)


@njit(inline="always")
def _forward(k, start, images, n, source, centre, axis, positions, half, pixel, lanes, lines):
    """Compute line integrals of the rays start.. of view k into lines (slices, turns, views, cells)."""
    slices, turns, _, cells = lines.shape
    where, near, far = (
        np.empty(n + _GROUP, np.uint32),
        np.empty(n + _GROUP, np.float32),
        np.empty(n + _GROUP, np.float32),
    )
    rays = np.empty((7, min(_CELLS, cells - start)))
    sums = np.empty(lanes, np.float32)
    width = np.uint64(lanes)
    _tabulate_rays(k, start, source, centre, axis, positions, half, pixel, n, rays)
    for c in range(rays.shape[1]):
        _, count, step = _march(rays, c, n, where, near, far)
        # Four sums: with a single one every addition would wait for the last.
        zero = vector.scaled(np.float32(0.0), vector.load(images, np.uint64(0), lanes))
        one, two, three, four = zero, zero, zero, zero
        for j in range(np.uint64(0), count, np.uint64(2)):
            p, q = where[j] * width, where[j + np.uint64(1)] * width
            a, b = near[j], far[j]
            one = vector.plus(one, vector.scaled(a, vector.load(images, p, lanes)))
            two = vector.plus(two, vector.scaled(b, vector.load(images, p + step * width, lanes)))
            a, b = near[j + np.uint64(1)], far[j + np.uint64(1)]
            three = vector.plus(three, vector.scaled(a, vector.load(images, q, lanes)))
            four = vector.plus(four, vector.scaled(b, vector.load(images, q + step * width, lanes)))
        one, other = vector.plus(one, two), vector.plus(three, four)
        vector.store(sums, np.uint64(0), vector.plus(one, other))
        for s in range(slices):
            for q in range(turns):
                lines[s, q, k, start + c] = sums[s * turns + q]


@njit(inline="always")
def _adjoint(k, start, lines, n, source, centre, axis, positions, half, pixel, lanes, images):
    """Add the values of the rays start.. of view k to images, along the rays."""
    slices, turns, _, cells = lines.shape
    where, near, far = (
        np.empty(n + _GROUP, np.uint32),
        np.empty(n + _GROUP, np.float32),
        np.empty(n + _GROUP, np.float32),
    )
    rays = np.empty((7, min(_CELLS, cells - start)))
    values = np.zeros(lanes, np.float32)
    width = np.uint64(lanes)
    _tabulate_rays(k, start, source, centre, axis, positions, half, pixel, n, rays)
    for c in range(rays.shape[1]):
        for s in range(slices):
            for q in range(turns):
                values[s * turns + q] = lines[s, q, k, start + c]
        value = vector.load(values, np.uint64(0), lanes)
        count, _, step = _march(rays, c, n, where, near, far)
        for j in range(count):
            p = where[j] * width
            q = p + step * width
            vector.store(images, p, vector.plus(vector.load(images, p, lanes), vector.scaled(near[j], value)))
            vector.store(images, q, vector.plus(vector.load(images, q, lanes), vector.scaled(far[j], value)))


@njit(inline="always")
def _forward_views(images, n, source, centre, axis, positions, half, pixel, lanes, lines):
    views, cells = lines.shape[2:]
    for task in prange(views * _tasks(cells)):
        k, start = np.int64(task) // _tasks(cells), np.int64(task) % _tasks(cells) * _CELLS
        _forward(k, start, images, n, source, centre, axis, positions, half, pixel, lanes, lines)


@njit(inline="always")
def _adjoint_views(lines, n, source, centre, axis, positions, half, pixel, lanes, work):
    views, cells = lines.shape[2:]
    threads, tasks = work.shape[0], views * _tasks(cells)
    for tt in prange(threads):
        t = np.int64(tt)
        work[t] = np.float32(0.0)
        for task in range(t * tasks // threads, (t + 1) * tasks // threads):
            k, start = task // _tasks(cells), task % _tasks(cells) * _CELLS
            _adjoint(k, start, lines, n, source, centre, axis, positions, half, pixel, lanes, work[t])


# The width of a vector must be known at compile time: one kernel for each number of lanes.
@njit(parallel=True, cache=True, fastmath=_FAST)
def forward_1(images, n, source, centre, axis, positions, half, pixel, lines):
    """Fill lines (slices, turns, views, cells) with line integrals of a flat block of one lane."""
    _forward_views(images, n, source, centre, axis, positions, half, pixel, 1, lines)


@njit(parallel=True, cache=True, fastmath=_FAST)
def forward_4(images, n, source, centre, axis, positions, half, pixel, lines):
    """Do the work of `forward_1` with four lanes; lanes beyond slices * turns only fill up the vector."""
    _forward_views(images, n, source, centre, axis, positions, half, pixel, 4, lines)


@njit(parallel=True, cache=True, fastmath=_FAST)
def forward_16(images, n, source, centre, axis, positions, half, pixel, lines):
    """Do the work of `forward_4` with sixteen lanes."""
    _forward_views(images, n, source, centre, axis, positions, half, pixel, 16, lines)


@njit(parallel=True, cache=True, fastmath=_FAST)
def adjoint_1(lines, n, source, centre, axis, positions, half, pixel, work):
    """Fill work (threads, pixels * lanes), whose sum over the threads is the transpose of `forward_1`."""
    _adjoint_views(lines, n, source, centre, axis, positions, half, pixel, 1, work)


@njit(parallel=True, cache=True, fastmath=_FAST)
def adjoint_4(lines, n, source, centre, axis, positions, half, pixel, work):
    """Do the work of `adjoint_1` for `forward_4`."""
    _adjoint_views(lines, n, source, centre, axis, positions, half, pixel, 4, work)


@njit(parallel=True, cache=True, fastmath=_FAST)
def adjoint_16(lines, n, source, centre, axis, positions, half, pixel, work):
    """Do the work of `adjoint_1` for `forward_16`."""
    _adjoint_views(lines, n, source, centre, axis, positions, half, pixel, 16, work)


@njit(inline="always")
def _tasks(cells):
    return (cells + _CELLS - 1) // _CELLS


@njit(inline="always")
def _turned(quarters, n, row):
    """Return the index of pixel (i, j) in an image turned by quarters (as np.rot90): at + i * along + j * across."""
    if quarters == 0:
        return 0, row, 1
    if quarters == 1:
        return n - 1, -1, row
    if quarters == 2:
        return (n - 1) * (row + 1), -row, -1
    return (n - 1) * row, 1, -row


@njit(parallel=True, cache=True)
def pack(images, quarters, out):
    """Fill out (n + 3, n + 3, lanes) with images (slices, n, n) turned by each of the quarters, and the border."""
    slices, n, _ = images.shape
    turns = quarters.size
    for ii in prange(n + BORDER):
        i = np.int64(ii) - 1
        out[i + 1] = np.float32(0.0)
        if 0 <= i < n:
            for lane in range(slices * turns):
                image = images[lane // turns].ravel()
                at, along, across = _turned(quarters[lane % turns], n, n)
                for j in range(n):
                    out[i + 1, j + 1, lane] = image[np.uint64(at + i * along + j * across)]


@njit(parallel=True, cache=True)
def unpack(work, quarters, lanes, out):
    """Fill out (slices, n, n) with the transpose of `pack`, of work (threads, pixels * lanes) summed over threads."""
    slices, n, _ = out.shape
    turns, threads, row = quarters.size, work.shape[0], n + BORDER
    for ii in prange(n):
        i = np.int64(ii)
        for s in range(slices):
            out[s, i] = np.float32(0.0)
            for q in range(turns):
                at, along, across = _turned((4 - quarters[q]) % 4, n, row)
                begin = (at + i * along + row + 1) * lanes + s * turns + q
                for t in range(threads):
                    for j in range(n):
                        out[s, i, j] += work[t, np.uint64(begin + j * across * lanes)]
