"""Kernels of the back-projection. Symbols are defined in docs/look-up/conventions.md#source-frame.

The kernels sum filtered rows at u(x, k), over (n.(x - S))**power. Rows have one zero cell at either end: rays beyond
the detector add nothing. Cell m is centred at (m + 1/2 - n/2) pitch and has the index m + 1.

The position of a pixel's shadow, and its two weights, are first tabulated in long loops without a branch, which
vectorise; the sum over the views of a table then stays in registers.
"""

import math

import numpy as np
from numba import njit, prange

from sawmill_tomography.projection import _lanes_numba as vector

_FAST = {"contract", "nsz", "arcp", "reassoc"}
# Pixels of a tile: the cells under it, for 64 slices and four views, stay in the second-level cache.
_TILE_X, _TILE_Y = 32, 16
# Slices arranged at a time, the lanes of a vector: more columns evict one another from the first-level cache.
_TOGETHER = 16
# Only an index whose sign bit is known to be clear is gathered with 32 bits.
_UNSIGNED = np.uint32(0x7FFFFFFF)


@njit(inline="always")
def _tabulate(x, y, along_x, along_y, c, s, base, live, frame, at, left, right, g):
    """Write to [g] the cells under the pixels that are some steps along x and y from the pixel at (x, y)."""
    big_r, c_tau, s_tau, scale, offset, top, pixel, power = frame
    # q = Rot(-source_angle) (x, y) + (0, R), its x component and its component along the detector normal.
    qx = c * x + s * y
    qy = c * y - s * x + big_r
    across, across_x, across_y = np.float32(qx) * scale, np.float32(c * pixel) * scale, np.float32(s * pixel) * scale
    depth = np.float32(qy * c_tau - qx * s_tau)
    depth_x = np.float32(-(s * c_tau + c * s_tau) * pixel)
    depth_y = np.float32((c * c_tau - s * s_tau) * pixel)
    zero, one = np.float32(0.0), np.float32(1.0)
    for p in range(along_x.size):
        i, j = along_x[p], along_y[p]
        inverse = one / (depth + i * depth_x + j * depth_y)
        t = (across + i * across_x + j * across_y) * inverse + offset
        # Zero first: where the shadow is nan, zero results.
        t = min(max(zero, t), top)
        cell = np.int32(t)
        weight = live * inverse * (inverse if power == 2 else one)
        share = weight * (t - np.float32(cell))
        at[g, p] = base + np.uint32(cell)
        left[g, p] = weight - share
        right[g, p] = share


@njit(inline="always")
def _frame(padded, big_r, sdd, u_c, tau, pitch, pixel, power):
    """Return the constants of all views, positions on the detector in cells."""
    offset = np.float32(u_c / pitch + 0.5 * (padded - 2) + 0.5)
    top = np.float32(padded - 1.001)
    return big_r, math.cos(tau), math.sin(tau), np.float32(sdd / pitch), offset, top, pixel, power


@njit(parallel=True, cache=True, nogil=True, fastmath=_FAST)
def back_project(pairs, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, out):
    """Back-project a slice to out [x, y]; pairs (views, cells + 2) uint64 hold a cell's and the next one's float32."""
    views, padded = pairs.shape
    flat = pairs.ravel()
    cosine, sine = np.cos(source_angle), np.sin(source_angle)
    frame = _frame(padded, big_r, sdd, u_c, tau, pitch, pixel, power)
    size = out.shape[0]
    y = low_y + 0.5 * pixel
    for ii in prange(size):
        i = np.int64(ii)
        x = low_x + (i + 0.5) * pixel
        line = np.zeros(size, np.float32)
        none, along = np.zeros(size, np.float32), np.arange(size).astype(np.float32)
        at = np.empty((4, size), np.uint32)
        left = np.empty((4, size), np.float32)
        right = np.empty((4, size), np.float32)
        for k in range(0, views, 4):
            for g in range(4):
                view = min(k + g, views - 1)
                live = np.float32(k + g < views)
                base = np.uint32(view * padded)
                _tabulate(x, y, none, along, cosine[view], sine[view], base, live, frame, at, left, right, g)
            for j in range(size):
                a, b = flat[at[0, j] & _UNSIGNED], flat[at[1, j] & _UNSIGNED]
                c, d = flat[at[2, j] & _UNSIGNED], flat[at[3, j] & _UNSIGNED]
                near, far = line[j], np.float32(0.0)
                near += left[0, j] * np.uint32(a).view(np.float32)
                near += left[1, j] * np.uint32(b).view(np.float32)
                near += left[2, j] * np.uint32(c).view(np.float32)
                near += left[3, j] * np.uint32(d).view(np.float32)
                far += right[0, j] * np.uint32(a >> np.uint64(32)).view(np.float32)
                far += right[1, j] * np.uint32(b >> np.uint64(32)).view(np.float32)
                far += right[2, j] * np.uint32(c >> np.uint64(32)).view(np.float32)
                far += right[3, j] * np.uint32(d >> np.uint64(32)).view(np.float32)
                line[j] = near + far
        for j in range(size):
            out[i, j] = line[j]


@njit(inline="always")
def _back_project_lanes(rows, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, width, out):
    views, padded, lanes = rows.shape
    flat, cell = rows.ravel(), np.uint64(lanes)
    cosine, sine = np.cos(source_angle), np.sin(source_angle)
    frame = _frame(padded, big_r, sdd, u_c, tau, pitch, pixel, power)
    images, size = out.shape[0], out.shape[1]
    pixels, across = _TILE_X * _TILE_Y, (size + _TILE_Y - 1) // _TILE_Y
    along_x = (np.arange(pixels) // _TILE_Y).astype(np.float32)
    along_y = (np.arange(pixels) % _TILE_Y).astype(np.float32)
    for tt in prange((size + _TILE_X - 1) // _TILE_X * across):
        tile = np.int64(tt)
        total = np.zeros(pixels * lanes, np.float32)
        at = np.empty((4, pixels), np.uint32)
        left = np.empty((4, pixels), np.float32)
        right = np.empty((4, pixels), np.float32)
        i0, j0 = tile // across * _TILE_X, tile % across * _TILE_Y
        x, y = low_x + (i0 + 0.5) * pixel, low_y + (j0 + 0.5) * pixel
        for k in range(0, views, 4):
            for g in range(4):
                view = min(k + g, views - 1)
                live = np.float32(k + g < views)
                base, c, s = np.uint32(view * padded), cosine[view], sine[view]
                _tabulate(x, y, along_x, along_y, c, s, base, live, frame, at, left, right, g)
            # Pixels of the tile beyond the image are summed too, and not written.
            for p in range(pixels):
                a, b = np.uint64(at[0, p]) * cell, np.uint64(at[1, p]) * cell
                c, d = np.uint64(at[2, p]) * cell, np.uint64(at[3, p]) * cell
                # In registers: the compiler would load them from memory again for each vector.
                left_a, left_b, left_c, left_d = left[0, p], left[1, p], left[2, p], left[3, p]
                right_a, right_b, right_c, right_d = right[0, p], right[1, p], right[2, p], right[3, p]
                for lane in range(np.uint64(0), cell, np.uint64(width)):
                    here = lane * np.uint64(pixels) + np.uint64(p) * np.uint64(width)
                    near = vector.plus(
                        vector.load(total, here, width), vector.scaled(left_a, vector.load(flat, a + lane, width))
                    )
                    far = vector.scaled(right_a, vector.load(flat, a + lane + cell, width))
                    near = vector.plus(near, vector.scaled(left_b, vector.load(flat, b + lane, width)))
                    far = vector.plus(far, vector.scaled(right_b, vector.load(flat, b + lane + cell, width)))
                    near = vector.plus(near, vector.scaled(left_c, vector.load(flat, c + lane, width)))
                    far = vector.plus(far, vector.scaled(right_c, vector.load(flat, c + lane + cell, width)))
                    near = vector.plus(near, vector.scaled(left_d, vector.load(flat, d + lane, width)))
                    far = vector.plus(far, vector.scaled(right_d, vector.load(flat, d + lane + cell, width)))
                    vector.store(total, here, vector.plus(near, far))
        for n in range(images):
            first = n // width * width * pixels + n % width
            for i in range(min(_TILE_X, size - i0)):
                for j in range(min(_TILE_Y, size - j0)):
                    out[n, i0 + i, j0 + j] = total[first + (i * _TILE_Y + j) * width]


@njit(parallel=True, cache=True, nogil=True, fastmath=_FAST)
def back_project_4(rows, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, out):
    """Back-project rows (views, cells + 2, 4) to images out [image, x, y], a lane for each image."""
    _back_project_lanes(rows, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, 4, out)


@njit(parallel=True, cache=True, nogil=True, fastmath=_FAST)
def back_project_16(rows, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, out):
    """Do the work of `back_project_4` with any multiple of sixteen lanes; lanes beyond the images fill up vectors."""
    _back_project_lanes(rows, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, 16, out)


@njit(cache=True, nogil=True)
def lay_out(filtered, view_weight, cell_weight, rows):
    """Weigh filtered rows (views, slices, cells) into rows (views, cells + 2, lanes), the slices innermost."""
    views, slices, cells = filtered.shape
    lanes = rows.shape[2]
    zero = np.float32(0.0)
    weight = np.empty(cells, np.float32)
    for k in range(views):
        for m in range(cells):
            weight[m] = view_weight[k] * cell_weight[m]
        for first in range(0, slices, _TOGETHER):
            stop = min(first + _TOGETHER, slices)
            for m in range(cells):
                for n in range(first, stop):
                    rows[k, m + 1, n] = weight[m] * filtered[k, n, m]
                for n in range(stop, min(first + _TOGETHER, lanes)):
                    rows[k, m + 1, n] = zero
        for n in range(lanes):
            rows[k, 0, n] = rows[k, cells + 1, n] = zero


@njit(cache=True, nogil=True)
def pair_up(filtered, view_weight, cell_weight, pairs):
    """Weigh filtered rows (views, cells) into pairs (views, cells + 2, 2): a cell and its right neighbour."""
    views, cells = filtered.shape
    zero = np.float32(0.0)
    for k in range(views):
        before = zero
        for m in range(cells):
            value = np.float32(view_weight[k] * cell_weight[m]) * filtered[k, m]
            pairs[k, m, 0], pairs[k, m, 1] = before, value
            before = value
        pairs[k, cells, 0], pairs[k, cells, 1] = before, zero
        pairs[k, cells + 1, 0] = pairs[k, cells + 1, 1] = zero
