"""Kernels of the back-projection. Symbols are those of docs/conventions.md#source-frame.

All of them sum filtered rows at u(x, k), over (n.(x - S))**power. Rows carry one zero cell at either end: what the
detector does not see adds nothing. Cell m is centred at (m + 1/2 - n/2) pitch and stands at index m + 1.

Where the shadow of a pixel falls, and its two weights, are first written into tables, in long loops without a branch,
which vectorise; the sum over the views of a table then stays in registers.
"""

import math

import numpy as np
from numba import njit, prange

_FAST = {"contract", "nsz", "arcp", "reassoc"}
# Pixels along a side of a tile: the cells under it, for 64 slices and four views, stay in the second-level cache.
_TILE = 16
# Slices laid out at a time, the lanes of a vector: columns of more evict one another from the first-level cache.
_TOGETHER = 16
# Only an index whose sign bit is known to be clear is gathered with 32 bits.
_UNSIGNED = np.uint32(0x7FFFFFFF)


@njit(inline="always")
def _tabulate(x, y, along_x, along_y, c, s, base, live, frame, at, left, right, g):
    """Write to [g] the cells under the pixels that are some steps along x and y from the one at (x, y)."""
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
        # Zero first: of a shadow that is nowhere, not a number, it is the zero that counts.
        t = min(max(zero, t), top)
        cell = np.int32(t)
        weight = live * inverse * (inverse if power == 2 else one)
        share = weight * (t - np.float32(cell))
        at[g, p] = base + np.uint32(cell)
        left[g, p] = weight - share
        right[g, p] = share


@njit(inline="always")
def _frame(padded, big_r, sdd, u_c, tau, pitch, pixel, power):
    """What is the same for every view, positions on the detector in cells."""
    offset = np.float32(u_c / pitch + 0.5 * (padded - 2) + 0.5)
    top = np.float32(padded - 1.001)
    return big_r, math.cos(tau), math.sin(tau), np.float32(sdd / pitch), offset, top, pixel, power


@njit(parallel=True, cache=True, nogil=True, fastmath=_FAST)
def back_project(pairs, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, out):
    """One slice out [x, y]; pairs (views, cells + 2) uint64 hold a cell's float32 and its right neighbour's."""
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


@njit(parallel=True, cache=True, nogil=True, fastmath=_FAST)
def back_project_quarters(pairs, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, out):
    """The same where view k + n views / 4 is n quarter turns after view k; out [quarter, x, y] is seen from view k.

    The four share cells and weights. source_angle needs only the angles of the first quarter.
    """
    views, padded = pairs.shape
    flat = pairs.ravel()
    cosine, sine = np.cos(source_angle), np.sin(source_angle)
    frame = _frame(padded, big_r, sdd, u_c, tau, pitch, pixel, power)
    size = out.shape[1]
    y = low_y + 0.5 * pixel
    quarter = views // 4
    turn = np.uint32(quarter * padded)
    for ii in prange(size):
        i = np.int64(ii)
        x = low_x + (i + 0.5) * pixel
        lines = np.zeros((4, size), np.float32)
        none, along = np.zeros(size, np.float32), np.arange(size).astype(np.float32)
        at = np.empty((1, size), np.uint32)
        left = np.empty((1, size), np.float32)
        right = np.empty((1, size), np.float32)
        for k in range(quarter):
            base, live = np.uint32(k * padded), np.float32(1.0)
            _tabulate(x, y, none, along, cosine[k], sine[k], base, live, frame, at, left, right, 0)
            for j in range(size):
                near, far, here = left[0, j], right[0, j], at[0, j]
                a = flat[here & _UNSIGNED]
                b = flat[(here + turn) & _UNSIGNED]
                c = flat[(here + np.uint32(2) * turn) & _UNSIGNED]
                d = flat[(here + np.uint32(3) * turn) & _UNSIGNED]
                a0, a1 = np.uint32(a).view(np.float32), np.uint32(a >> np.uint64(32)).view(np.float32)
                b0, b1 = np.uint32(b).view(np.float32), np.uint32(b >> np.uint64(32)).view(np.float32)
                c0, c1 = np.uint32(c).view(np.float32), np.uint32(c >> np.uint64(32)).view(np.float32)
                d0, d1 = np.uint32(d).view(np.float32), np.uint32(d >> np.uint64(32)).view(np.float32)
                lines[0, j] += near * a0 + far * a1
                lines[1, j] += near * b0 + far * b1
                lines[2, j] += near * c0 + far * c1
                lines[3, j] += near * d0 + far * d1
        for q in range(4):
            for j in range(size):
                out[q, i, j] = lines[q, j]


@njit(parallel=True, cache=True, nogil=True, fastmath=_FAST)
def back_project_block(rows, source_angle, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power, out):
    """Slices out [slice, x, y] from rows (views, cells + 2, lanes); lanes beyond the slices fill up vectors."""
    views, padded, lanes = rows.shape
    flat = rows.ravel()
    cosine, sine = np.cos(source_angle), np.sin(source_angle)
    frame = _frame(padded, big_r, sdd, u_c, tau, pitch, pixel, power)
    slices, size = out.shape[0], out.shape[1]
    across = (size + _TILE - 1) // _TILE
    one_cell = np.uint64(lanes)
    along_x = (np.arange(_TILE * _TILE) // _TILE).astype(np.float32)
    along_y = (np.arange(_TILE * _TILE) % _TILE).astype(np.float32)
    for tt in prange(across * across):
        tile = np.int64(tt)
        total = np.zeros(_TILE * _TILE * lanes, np.float32)
        at = np.empty((4, _TILE * _TILE), np.uint32)
        left = np.empty((4, _TILE * _TILE), np.float32)
        right = np.empty((4, _TILE * _TILE), np.float32)
        i0, j0 = tile // across * _TILE, tile % across * _TILE
        x, y = low_x + (i0 + 0.5) * pixel, low_y + (j0 + 0.5) * pixel
        for k in range(0, views, 4):
            for g in range(4):
                view = min(k + g, views - 1)
                live = np.float32(k + g < views)
                base, c, s = np.uint32(view * padded), cosine[view], sine[view]
                _tabulate(x, y, along_x, along_y, c, s, base, live, frame, at, left, right, g)
            # Pixels of the tile beyond the image, too: they are added up and left there.
            for p in range(_TILE * _TILE):
                here = np.uint64(p) * one_cell
                a0, b0 = np.uint64(at[0, p]) * one_cell, np.uint64(at[1, p]) * one_cell
                c0, d0 = np.uint64(at[2, p]) * one_cell, np.uint64(at[3, p]) * one_cell
                a1, b1, c1, d1 = a0 + one_cell, b0 + one_cell, c0 + one_cell, d0 + one_cell
                left_a, left_b, left_c, left_d = left[0, p], left[1, p], left[2, p], left[3, p]
                right_a, right_b, right_c, right_d = right[0, p], right[1, p], right[2, p], right[3, p]
                for lane in range(lanes):
                    n = np.uint64(lane)
                    near, far = total[here + n], np.float32(0.0)
                    near += left_a * flat[a0 + n]
                    near += left_b * flat[b0 + n]
                    near += left_c * flat[c0 + n]
                    near += left_d * flat[d0 + n]
                    far += right_a * flat[a1 + n]
                    far += right_b * flat[b1 + n]
                    far += right_c * flat[c1 + n]
                    far += right_d * flat[d1 + n]
                    total[here + n] = near + far
        for n in range(slices):
            for i in range(min(_TILE, size - i0)):
                for j in range(min(_TILE, size - j0)):
                    out[n, i0 + i, j0 + j] = total[(i * _TILE + j) * lanes + n]


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
                for n in range(stop, first + _TOGETHER):
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
