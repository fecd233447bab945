"""Kernels of the analytic projection. They only loop; `analytic.py` checks, documents and allocates.

Symbols are those of docs/conventions.md#symbols, in the source frame of one view: the source stands at (0, -R), a
point V of the object at q = Rot(-beta) V + (0, R) seen from the source, and a ray to detector coordinate u runs along
a = (w cos tau, SDD + w sin tau), w = u - u_c. An edge A -> B is met at the distance |a| X / Y from the source, with
X = q_A x q_B and Y = a x (q_B - q_A); the chord of a polygon is minus the sum of these over its edges, each signed
by the direction in which it runs over the detector.
"""

import math

import numpy as np
from numba import njit, prange

# psi, R, SDD, u_c, tau, t_x, t_y: the rows of the derivative.
PARAMETERS = 7
# Rows that one view fills: the derivatives, the projection, and what `gram` puts beside them.
ROWS = 13
# Below this relative change of Y over a cell the midpoint is exact to 2e-6 of the distance; above, three Gauss points.
_SMOOTH = 0.005
_GAUSS_X = math.sqrt(0.6)

_FAST = {"reassoc", "contract", "arcp", "nsz"}

# The parts are functions of their own: LLVM inlines what pays, and a quarter of the time compiles them.


@njit(fastmath=_FAST)
def _edge_point(u, share, sign, big_r, u_c, sdd, c_tau, s_tau, x, ex, ey, dx, row, m, derivative):
    """Add one quadrature point's share of the distance, of its derivatives and of the first moments, to cell m."""
    w = u - u_c
    ax = w * c_tau
    ay = sdd + w * s_tau
    n = math.sqrt(ax * ax + ay * ay)
    inv_y = 1.0 / (ax * ey - ay * ex)
    s = x * inv_y
    f = sign * share
    row[7, m] += f * n * s
    if derivative:
        per_n = 1.0 / n
        g = f * n * inv_y
        h = f * s * per_n
        row[0, m] += g * (dx[0] + s * (ax * ex + ay * ey))
        row[1, m] += g * dx[1]
        row[2, m] += h * ay + g * s * ex
        row[3, m] += -h * (ax * c_tau + ay * s_tau) + g * s * (c_tau * ey - s_tau * ex)
        row[4, m] += w * (h * (ay * c_tau - ax * s_tau) + g * s * (s_tau * ey + c_tau * ex))
        row[5, m] += g * dx[2]
        row[6, m] += g * dx[3]
        # From the source to the edge, at the distance n s: integrals of the coordinates around the COR.
        half = 0.5 * f * n * s * s
        row[11, m] += half * ax
        row[12, m] += half * ay - f * n * s * big_r


@njit(fastmath=_FAST)
def _cell_under(u, u_first, pitch, cells):
    """The cell that u lies in: -1 before the first and of what is not a number, `cells` beyond the last."""
    # Bounded while it is a float: a number that no integer holds may become any. -1 first, or not a number would pass.
    return int(math.floor(min(max(-1.0, (u - u_first) / pitch), float(cells))))


@njit(fastmath=_FAST)
def _edge(edge, frame, t_x, t_y, c_b, s_b, u_first, pitch, cells, rays, row, derivative):
    """Add one polygon edge to the row of one view."""
    big_r, sdd, u_c, tau = frame[1], frame[2], frame[3], frame[4]
    c_tau = math.cos(tau)
    s_tau = math.sin(tau)
    xa, ya = edge[0] + t_x, edge[1] + t_y
    xb, yb = edge[2] + t_x, edge[3] + t_y
    qax, qay = c_b * xa + s_b * ya, c_b * ya - s_b * xa + big_r
    qbx, qby = c_b * xb + s_b * yb, c_b * yb - s_b * xb + big_r
    ua = u_c + sdd * qax / (qay * c_tau - qax * s_tau)
    ub = u_c + sdd * qbx / (qby * c_tau - qbx * s_tau)
    low, high = min(ua, ub), max(ua, ub)
    if high <= u_first or low >= u_first + cells * pitch or high - low < 1e-9:
        return
    sign = -edge[4] if ub > ua else edge[4]
    ex, ey = qbx - qax, qby - qay
    x = qax * qby - qay * qbx
    dx = (-big_r * ey, -ex, c_b * ey + s_b * ex, s_b * ey - c_b * ex)
    first = max(0, _cell_under(low, u_first, pitch, cells))
    last = min(cells - 1, _cell_under(high, u_first, pitch, cells))
    y_slope = c_tau * ey - s_tau * ex
    for m in range(first, last + 1):
        left = u_first + m * pitch
        if rays > 0:
            for i in range(rays):
                u = left + (i + 0.5) * pitch / rays
                if low <= u < high:
                    _edge_point(u, 1.0 / rays, sign, big_r, u_c, sdd, c_tau, s_tau, x, ex, ey, dx, row, m, derivative)
            continue
        a = max(left, low)
        b = min(left + pitch, high)
        if b <= a:
            continue
        share = (b - a) / pitch
        mid = 0.5 * (a + b)
        w = mid - u_c
        y_mid = w * c_tau * ey - (sdd + w * s_tau) * ex
        if abs(y_slope * (b - a)) < _SMOOTH * abs(y_mid):
            _edge_point(mid, share, sign, big_r, u_c, sdd, c_tau, s_tau, x, ex, ey, dx, row, m, derivative)
        else:
            off = 0.5 * (b - a) * _GAUSS_X
            outer, inner = share * (5.0 / 18.0), share * (8.0 / 18.0)
            _edge_point(mid - off, outer, sign, big_r, u_c, sdd, c_tau, s_tau, x, ex, ey, dx, row, m, derivative)
            _edge_point(mid, inner, sign, big_r, u_c, sdd, c_tau, s_tau, x, ex, ey, dx, row, m, derivative)
            _edge_point(mid + off, outer, sign, big_r, u_c, sdd, c_tau, s_tau, x, ex, ey, dx, row, m, derivative)


@njit(fastmath=_FAST)
def _disc_distance(u, qx, qy, big_r, u_c, sdd, c_tau, s_tau, c_b, s_b, out):
    """Signed distance of the disc's centre to the ray at u (out[7]) and its seven derivatives (out[:7])."""
    w = u - u_c
    ax = w * c_tau
    ay = sdd + w * s_tau
    n = math.sqrt(ax * ax + ay * ay)
    nx, ny = ax / n, ay / n
    d = nx * qy - ny * qx
    # The distance along the ray to the foot of the perpendicular: how far a turn of the ray moves the distance.
    along = nx * qx + ny * qy
    out[7] = d
    out[0] = -(nx * qx + ny * (qy - big_r))
    out[1] = nx
    out[2] = -along * nx / n
    out[3] = -along * (c_tau * ny - s_tau * nx) / n
    out[4] = -along * w * (s_tau * ny + c_tau * nx) / n
    out[5] = -nx * s_b - ny * c_b
    out[6] = nx * c_b - ny * s_b


@njit(fastmath=_FAST)
def _segment(d, r):
    """Integral of 2 sqrt(r^2 - d^2) from 0 to d, d clipped to the disc."""
    d = min(max(d, -r), r)
    return d * math.sqrt(max(r * r - d * d, 0.0)) + r * r * math.asin(d / r)


@njit(fastmath=_FAST)
def _disc_moments(chord, d, nx, qx, qy, big_r, row, m):
    """Add a chord's first moments around the COR: its length times its middle, the foot of the perpendicular."""
    ny = math.sqrt(max(1.0 - nx * nx, 0.0))
    row[11, m] += chord * (qx + d * ny)
    row[12, m] += chord * (qy - d * nx - big_r)


@njit(fastmath=_FAST)
def _disc(disc, frame, t_x, t_y, c_b, s_b, u_first, pitch, cells, rays, row, derivative, left, right):
    """Add one disc to the row of one view; the signed distance grows with u."""
    big_r, sdd, u_c, tau = frame[1], frame[2], frame[3], frame[4]
    c_tau = math.cos(tau)
    s_tau = math.sin(tau)
    x, y = disc[0] + t_x, disc[1] + t_y
    qx, qy = c_b * x + s_b * y, c_b * y - s_b * x + big_r
    r, density = disc[2], disc[3]
    direction = math.atan2(qx, qy)
    half = math.asin(r / math.sqrt(qx * qx + qy * qy))
    low = u_c + sdd * math.sin(direction - half) / math.cos(direction - half + tau)
    high = u_c + sdd * math.sin(direction + half) / math.cos(direction + half + tau)
    first = max(0, _cell_under(low, u_first, pitch, cells))
    last = min(cells - 1, _cell_under(high, u_first, pitch, cells))
    if rays > 0:
        for m in range(first, last + 1):
            for i in range(rays):
                u = u_first + (m + (i + 0.5) / rays) * pitch
                _disc_distance(u, qx, qy, big_r, u_c, sdd, c_tau, s_tau, c_b, s_b, left)
                d = left[7]
                if abs(d) < r:
                    root = math.sqrt(r * r - d * d)
                    row[7, m] += density * 2.0 * root / rays
                    if derivative:
                        for p in range(7):
                            row[p, m] -= density * 2.0 * d * left[p] / (root * rays)
                        _disc_moments(density * 2.0 * root / rays, d, left[1], qx, qy, big_r, row, m)
        return
    if last < first:
        return
    _disc_distance(u_first + first * pitch, qx, qy, big_r, u_c, sdd, c_tau, s_tau, c_b, s_b, left)
    area_left = _segment(left[7], r)
    for m in range(first, last + 1):
        _disc_distance(u_first + (m + 1) * pitch, qx, qy, big_r, u_c, sdd, c_tau, s_tau, c_b, s_b, right)
        area_right = _segment(right[7], r)
        width = right[7] - left[7]
        mean = (area_right - area_left) / width
        row[7, m] += density * mean
        if derivative:
            chord_left = 2.0 * math.sqrt(max(r * r - left[7] * left[7], 0.0))
            chord_right = 2.0 * math.sqrt(max(r * r - right[7] * right[7], 0.0))
            for p in range(7):
                row[p, m] += density * ((chord_right - mean) * right[p] - (chord_left - mean) * left[p]) / width
            middle = 0.5 * (left[7] + right[7])
            _disc_moments(density * mean, middle, 0.5 * (left[1] + right[1]), qx, qy, big_r, row, m)
        for p in range(8):
            left[p] = right[p]
        area_left = area_right


@njit(fastmath=_FAST)
def _view(k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, cells, rays, row, derivative, left, right):
    beta = angles[k] + frame[0]
    c_b = math.cos(beta)
    s_b = math.sin(beta)
    for e in range(edges.shape[0]):
        _edge(edges[e], frame, t_x, t_y, c_b, s_b, u_first, pitch, cells, rays, row, derivative)
    for i in range(discs.shape[0]):
        _disc(discs[i], frame, t_x, t_y, c_b, s_b, u_first, pitch, cells, rays, row, derivative, left, right)


@njit(fastmath=_FAST)
def _project_view(k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, out):
    cells = out.shape[1]
    row = np.zeros((ROWS, cells))
    left = np.empty(8)
    right = np.empty(8)
    _view(k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, cells, rays, row, False, left, right)
    for m in range(cells):
        out[k, m] = row[7, m]


@njit(parallel=True, cache=True, fastmath=_FAST)
def project(edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, out):
    """Fill out (views, cells) with the projection; rays = 0 averages over the cells."""
    for k in prange(out.shape[0]):
        _project_view(np.int64(k), edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, out)


@njit(cache=True, fastmath=_FAST)
def project_in_one_thread(edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, out):
    """As `project`, where handing work to threads costs more than the work."""
    for k in range(out.shape[0]):
        _project_view(k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, out)


@njit(parallel=True, cache=True, fastmath=_FAST)
def project_with_derivative(edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, out):
    """Fill out (8 or 10, views, cells): the seven derivatives, the projection, the first moments in x and y."""
    count, views, cells = out.shape
    for kk in prange(views):
        k = np.int64(kk)
        row = np.zeros((ROWS, cells))
        left = np.empty(8)
        right = np.empty(8)
        _view(k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, cells, rays, row, True, left, right)
        for p in range(8):
            for m in range(cells):
                out[p, k, m] = row[p, m]
        if count > 8:
            c, s = math.cos(angles[k] + frame[0]), math.sin(angles[k] + frame[0])
            for m in range(cells):
                out[8, k, m] = c * row[11, m] - s * row[12, m]
                out[9, k, m] = s * row[11, m] + c * row[12, m]


@njit(fastmath=_FAST)
def _blur_row(line, taps, cells, padded):
    """Convolve one line with the symmetric taps (the middle one first), continued evenly beyond its ends."""
    reach = taps.size - 1
    for m in range(cells):
        padded[reach + m] = line[m]
    for j in range(reach):
        padded[reach - 1 - j] = line[min(j, cells - 1)]
        padded[reach + cells + j] = line[max(cells - 1 - j, 0)]
    for m in range(cells):
        line[m] *= taps[0]
    for j in range(1, taps.size):
        tap = taps[j]
        for m in range(cells):
            line[m] += tap * (padded[reach + m - j] + padded[reach + m + j])


@njit(fastmath=_FAST)
def _gram_view(k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, hardening, taps, out):
    cells = sinogram.shape[1]
    count = out.shape[1]
    row = np.zeros((ROWS, cells))
    left = np.empty(8)
    right = np.empty(8)
    _view(k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, cells, rays, row, True, left, right)
    for m in range(cells):
        row[8, m] = 1.0
        row[9, m] = sinogram[k, m]
    if count > 10:
        c, s = math.cos(angles[k] + frame[0]), math.sin(angles[k] + frame[0])
        for m in range(cells):
            row[10, m] = row[7, m] * row[7, m]
            x, y = row[11, m], row[12, m]
            row[11, m] = c * x - s * y
            row[12, m] = s * x + c * y
        for p in range(7):
            for m in range(cells):
                row[p, m] *= 1.0 + 2.0 * hardening * row[7, m]
    if taps.size > 1:
        padded = np.empty(cells + 2 * taps.size)
        for p in range(count):
            if p not in (8, 9):
                _blur_row(row[p], taps, cells, padded)
    if weights.shape[0] > 0:
        for p in range(count):
            for m in range(cells):
                row[p, m] *= math.sqrt(weights[k, m])
    for p in range(count):
        for q in range(p + 1):
            total = 0.0
            for m in range(cells):
                total += row[p, m] * row[q, m]
            out[k, p, q] = total
            out[k, q, p] = total


@njit(parallel=True, cache=True, fastmath=_FAST)
def gram(edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, hardening, taps, out):
    """Fill out (views, n, n) with each view's inner products of the first n terms, n = 10 or 13.

    The terms: seven derivatives of p + hardening p^2, p, 1, sinogram, p^2, the first moments in x and y.
    weights (views, cells) multiply each cell's products; an empty array weighs all alike. taps blur all but 1 and the
    sinogram along the detector, the middle one first; one tap blurs nothing.
    """
    for k in prange(sinogram.shape[0]):
        _gram_view(
            np.int64(k),
            edges,
            discs,
            frame,
            t_x,
            t_y,
            angles,
            u_first,
            pitch,
            rays,
            sinogram,
            weights,
            hardening,
            taps,
            out,
        )


@njit(cache=True, fastmath=_FAST)
def gram_in_one_thread(
    edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, hardening, taps, out
):
    """As `gram`, where handing work to threads costs more than the work."""
    for k in range(sinogram.shape[0]):
        _gram_view(
            k, edges, discs, frame, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, hardening, taps, out
        )
