"""Kernels of the analytic projection. They only loop; `analytic.py` checks, documents and allocates.

Symbols are defined in docs/look-up/conventions.md#symbols, in the source frame of one view: the source is at (0, -R), a
point V of the object at q = Rot(-beta) V + (0, R) seen from the source, and a ray to detector coordinate u runs along
a = (w cos tau, SDD + w sin tau), w = u - u_c. An edge A -> B is met at the distance |a| X / Y from the source, with
X = q_A x q_B and Y = a x (q_B - q_A); the chord of a polygon is minus the sum of these over its edges, each signed
by the direction in which it runs over the detector.

Lines (modules, 15) are `DetectorCells.lines`: every module of the detector is a flat line with an SDD, u_c and tau of
its own.
"""

import math

import numpy as np
from numba import njit, prange

# psi, R, SDD, u_c, tau, t_x, t_y: the rows of the derivative.
PARAMETERS = 7
# Rows that one view fills: the derivatives, the projection, the first moments in the view's axes, the derivatives by
# aspect and shear.
ROWS = 12
# Terms of `gram`: the derivatives, the projection, one, the data.
TERMS = 10
# Below this relative change of Y over a cell the midpoint is exact to 2e-6 of the distance; above, three Gauss points,
# here from the middle in cells, and their weights.
_SMOOTH = 0.005
_NODES = (0.0, -0.5 * math.sqrt(0.6), 0.5 * math.sqrt(0.6))
_WEIGHTS = (8.0 / 18.0, 5.0 / 18.0, 5.0 / 18.0)
# A cell's derivatives are made of sums over all edges, with k = density / Y, s = X / Y and the edge's vector e: k X,
# k e_x, k e_y, k s e_x, k s e_y; for the moments k X s; for aspect and shear k (dX - s a x de). The row behind them
# holds 1 / Y of one edge, then |a|.
SUMS = 8
# Number of rows in one step of the inner products.
ROWS_AT_ONCE = 4

_FAST = {"reassoc", "contract", "arcp", "nsz"}

# The parts are functions of their own: LLVM inlines where it pays, and a quarter of the time compiles them. With
# NumPy's error model a division is not tested for zero: a test keeps loops from being vectorised.


@njit(fastmath=_FAST, error_model="numpy")
def _edge_point(u, share, line, big_r, sdd, u_c, c_tau, s_tau, c_b, s_b, row, m, derivative):
    """Add one quadrature point's share of the distance, its derivatives and the first moments to cell m."""
    x, ex, ey = line[0], line[1], line[2]
    w = u - u_c
    ax = w * c_tau
    ay = sdd + w * s_tau
    n = math.sqrt(ax * ax + ay * ay)
    inv_y = 1.0 / (ax * ey - ay * ex)
    s = x * inv_y
    row[7, m] += share * n * s
    if derivative:
        g = share * n * inv_y
        h = share * s / n
        row[0, m] += g * (s * (ax * ex + ay * ey) - big_r * ey)
        row[1, m] -= g * ex
        row[2, m] += h * ay + g * s * ex
        row[3, m] += g * s * (c_tau * ey - s_tau * ex) - h * (ax * c_tau + ay * s_tau)
        row[4, m] += w * (h * (ay * c_tau - ax * s_tau) + g * s * (s_tau * ey + c_tau * ex))
        row[5, m] += g * (c_b * ey + s_b * ex)
        row[6, m] += g * (s_b * ey - c_b * ex)
        if derivative > 1:
            # From the source to the edge, at the distance n s: integrals of the coordinates around the COR.
            half = 0.5 * share * n * s * s
            row[8, m] += half * ax
            row[9, m] += half * ay - share * n * s * big_r
            for i in range(2):
                row[10 + i, m] += g * (line[6 + 3 * i] - s * (ax * line[8 + 3 * i] - ay * line[7 + 3 * i]))


@njit(fastmath=_FAST, error_model="numpy")
def _cell_under(u, u_first, pitch, cells):
    """Return the cell that holds u: -1 before the first cell and for nan, `cells` beyond the last."""
    # Clip the float first: a number beyond any integer may become any integer. -1 comes first, or nan would pass.
    return int(math.floor(min(max(-1.0, (u - u_first) / pitch), float(cells))))


@njit(fastmath=_FAST, error_model="numpy")
def _bend(edge, c_b, s_b, qax, qay, qbx, qby):
    """Return derivatives of X and of the edge's vector (x, y) by aspect (x / 2, -y / 2), then shear (y / 2, x / 2)."""
    hax, hay, hbx, hby = 0.5 * edge[0], 0.5 * edge[1], 0.5 * edge[2], 0.5 * edge[3]
    # The corners' movements, turned into the view: first by aspect, then by shear.
    a_x, a_y = c_b * hax - s_b * hay, -c_b * hay - s_b * hax
    b_x, b_y = c_b * hbx - s_b * hby, -c_b * hby - s_b * hbx
    c_x, c_y = c_b * hay + s_b * hax, c_b * hax - s_b * hay
    d_x, d_y = c_b * hby + s_b * hbx, c_b * hbx - s_b * hby
    aspect = a_x * qby + qax * b_y - a_y * qbx - qay * b_x
    shear = c_x * qby + qax * d_y - c_y * qbx - qay * d_x
    return aspect, b_x - a_x, b_y - a_y, shear, d_x - c_x, d_y - c_y


@njit(fastmath=_FAST, error_model="numpy")
def _seen(edges, big_r, t_x, t_y, c_b, s_b, derivative, seen, tangents):
    """Fill what all modules see of each edge, and the tangents (2, edges) of the angles from the COR to its ends.

    The least and the largest tangent are returned.
    `seen` (edges, 12): X, the edge's vector, its density signed by its direction on the detector; its ends on a module,
    which are left to that; `_bend`.
    """
    low, high = math.inf, -math.inf
    for e in range(len(edges)):
        edge, line = edges[e], seen[e]
        xa, ya = edge[0] + t_x, edge[1] + t_y
        xb, yb = edge[2] + t_x, edge[3] + t_y
        qax, qay = c_b * xa + s_b * ya, c_b * ya - s_b * xa + big_r
        qbx, qby = c_b * xb + s_b * yb, c_b * yb - s_b * xb + big_r
        ta, tb = qax / qay, qbx / qby
        line[0], line[1], line[2] = qax * qby - qay * qbx, qbx - qax, qby - qay
        line[3] = -edge[4] if tb > ta else edge[4]
        tangents[0, e], tangents[1, e] = min(ta, tb), max(ta, tb)
        if derivative > 1:
            line[6], line[7], line[8], line[9], line[10], line[11] = _bend(edge, c_b, s_b, qax, qay, qbx, qby)
        low, high = min(low, tangents[0, e]), max(high, tangents[1, e])
    return low, high


@njit(fastmath=_FAST, error_model="numpy")
def _whole_cells(line, f, first, last, centre, shift, sdd, c_tau, s_tau, derivative, sums, j):
    """Add one edge, times f, to the sums of cells first to last - 1, taken at their centres + shift."""
    x, ex, ey = line[0], line[1], line[2]
    slope, least = c_tau * ey - s_tau * ex, sdd * ex
    cells = range(np.uint64(first), np.uint64(last))
    if not derivative:
        for m in cells:
            sums[j, 0, m] += f * x / ((centre[m] + shift) * slope - least)
        return
    for m in cells:
        sums[j, SUMS, m] = 1.0 / ((centre[m] + shift) * slope - least)
    for m in cells:
        k = f * sums[j, SUMS, m]
        sums[j, 0, m] += k * x
        sums[j, 1, m] += k * ex
        sums[j, 2, m] += k * ey
    for m in cells:
        k = f * x * sums[j, SUMS, m] * sums[j, SUMS, m]
        sums[j, 3, m] += k * ex
        sums[j, 4, m] += k * ey
    if derivative > 1:
        for m in cells:
            s = x * sums[j, SUMS, m]
            sums[j, 5, m] += f * s * s
        for i in range(2):
            by_x, by_ex, by_ey = line[6 + 3 * i], line[7 + 3 * i], line[8 + 3 * i]
            for m in cells:
                w, inv_y = centre[m] + shift, sums[j, SUMS, m]
                bent = w * c_tau * by_ey - (sdd + w * s_tau) * by_ex
                sums[j, 6 + i, m] += f * inv_y * (by_x - x * inv_y * bent)


@njit(fastmath=_FAST, error_model="numpy")
def _add_sums(sums, j, first, last, centre, shift, big_r, sdd, c_tau, s_tau, c_b, s_b, row, derivative):
    """Add to cells first to last - 1 the terms of `_edge_point`, from the sums over all edges."""
    cells = range(np.uint64(first), np.uint64(last))
    n = sums[j, SUMS]
    for m in cells:
        w = centre[m] + shift
        ax, ay = w * c_tau, sdd + w * s_tau
        n[m] = math.sqrt(ax * ax + ay * ay)
    for m in cells:
        row[7, m] += n[m] * sums[j, 0, m]
    if not derivative:
        return
    for m in cells:
        w = centre[m] + shift
        along = w * c_tau * sums[j, 3, m] + (sdd + w * s_tau) * sums[j, 4, m]
        row[0, m] += n[m] * (along - big_r * sums[j, 2, m])
    for m in cells:
        row[1, m] -= n[m] * sums[j, 1, m]
    for m in cells:
        row[2, m] += (sdd + (centre[m] + shift) * s_tau) * sums[j, 0, m] / n[m] + n[m] * sums[j, 3, m]
    for m in cells:
        turned = c_tau * sums[j, 4, m] - s_tau * sums[j, 3, m]
        row[3, m] += n[m] * turned - (centre[m] + shift + sdd * s_tau) * sums[j, 0, m] / n[m]
    for m in cells:
        turned = s_tau * sums[j, 4, m] + c_tau * sums[j, 3, m]
        row[4, m] += (centre[m] + shift) * (n[m] * turned + sdd * c_tau * sums[j, 0, m] / n[m])
    for m in cells:
        row[5, m] += n[m] * (c_b * sums[j, 2, m] + s_b * sums[j, 1, m])
    for m in cells:
        row[6, m] += n[m] * (s_b * sums[j, 2, m] - c_b * sums[j, 1, m])
    if derivative > 1:
        for m in cells:
            row[8, m] += 0.5 * n[m] * (centre[m] + shift) * c_tau * sums[j, 5, m]
        for m in cells:
            ay = sdd + (centre[m] + shift) * s_tau
            row[9, m] += n[m] * (0.5 * ay * sums[j, 5, m] - big_r * sums[j, 0, m])
        for i in range(2):
            for m in cells:
                row[10 + i, m] += n[m] * sums[j, 6 + i, m]


@njit(fastmath=_FAST, error_model="numpy")
def _part_of_cell(line, m, a, b, pitch, big_r, sdd, u_c, c_tau, s_tau, c_b, s_b, row, derivative):
    """Add an edge's terms in the part [a, b] of cell m."""
    if b <= a:
        return
    mid, share = 0.5 * (a + b), line[3] * (b - a) / pitch
    y_slope = c_tau * line[2] - s_tau * line[1]
    smooth = abs(y_slope * (b - a)) < _SMOOTH * abs((mid - u_c) * y_slope - sdd * line[1])
    for i in range(1 if smooth else 3):
        u, f = mid + _NODES[i] * (b - a), share if smooth else _WEIGHTS[i] * share
        _edge_point(u, f, line, big_r, sdd, u_c, c_tau, s_tau, c_b, s_b, row, m, derivative)


@njit(fastmath=_FAST, error_model="numpy")
def _edges(seen, tangents, line_of_cells, c_b, s_b, u_first, pitch, cells, rays, row, derivative, over, centre, sums):
    """Add all polygons' edges to a module's cells of one view: whole cells by sums over the edges, parts each.

    `over` (edges,), `centre` (cells,) and `sums` (3, SUMS + 1, cells) are filled.
    """
    from_cell, to_cell = int(line_of_cells[0]), int(line_of_cells[1])
    big_r, sdd, u_c = line_of_cells[3], line_of_cells[4], line_of_cells[5]
    c_tau, s_tau = math.cos(line_of_cells[6]), math.sin(line_of_cells[6])
    u_from, u_to = u_first + from_cell * pitch, u_first + to_cell * pitch
    low, high, count = math.inf, -math.inf, 0
    for e in range(len(seen)):
        over[count] = e
        count += tangents[1, e] > line_of_cells[13] and tangents[0, e] < line_of_cells[14]
    for e in over[:count]:
        line = seen[e]
        line[4] = u_c + sdd * tangents[0, e] / (c_tau - tangents[0, e] * s_tau)
        line[5] = u_c + sdd * tangents[1, e] / (c_tau - tangents[1, e] * s_tau)
        low, high = min(low, line[4]), max(high, line[5])
    first = min(max(from_cell, _cell_under(low, u_first, pitch, cells)), to_cell)
    last = max(first, min(to_cell, _cell_under(high, u_first, pitch, cells) + 1))
    nodes = 0
    for m in range(first, last):
        centre[m] = u_first + (m + 0.5) * pitch - u_c
    for e in over[:count]:
        line = seen[e]
        low, high = max(line[4], u_from), min(line[5], u_to)
        if not (line[5] - line[4] >= 1e-9 and high > low):
            continue
        begin = max(from_cell, _cell_under(low, u_first, pitch, cells))
        end = min(to_cell - 1, _cell_under(high, u_first, pitch, cells))
        if rays > 1:
            for m in range(begin, end + 1):
                for i in range(rays):
                    u = u_first + (m + (i + 0.5) / rays) * pitch
                    if low <= u < high:
                        f = line[3] / rays
                        _edge_point(u, f, line, big_r, sdd, u_c, c_tau, s_tau, c_b, s_b, row, m, derivative)
            continue
        if rays == 1:  # the cells whose middle the edge covers
            begin += u_first + (begin + 0.5) * pitch < low
            end += u_first + (end + 0.5) * pitch < high
            near = far = end
        else:
            for m, a, b in (
                (begin, low, min(u_first + (begin + 1) * pitch, high)),
                (end, max(u_first + end * pitch, u_first + (begin + 1) * pitch), high),
            ):
                _part_of_cell(line, m, a, b, pitch, big_r, sdd, u_c, c_tau, s_tau, c_b, s_b, row, derivative)
            begin = min(begin + 1, end)
            # The cells around the point where the rays are parallel to the edge.
            parallel = u_c + sdd * line[1] / (c_tau * line[2] - s_tau * line[1])
            near = _cell_under(parallel - (1.0 / _SMOOTH - 0.5) * pitch, u_first, pitch, cells)
            far = _cell_under(parallel + (1.0 / _SMOOTH + 0.5) * pitch, u_first, pitch, cells)
            near = max(begin, min(end, near))
            far = max(near, min(end, far))
        while nodes < (3 if far > near else 1):
            for i in range(SUMS if derivative > 1 else 5):
                for m in range(np.uint64(first), np.uint64(last)):
                    sums[nodes, i, m] = 0.0
            nodes += 1
        # The cells on both sides, and those between them at each of three points.
        for i in range(5 if far > near else 2):
            j = max(0, i - 2)
            start, stop = (begin, near) if i == 0 else (far, end) if i == 1 else (near, far)
            f, shift = line[3] * (_WEIGHTS[j] if i > 1 else 1.0), _NODES[j] * pitch
            _whole_cells(line, f, start, stop, centre, shift, sdd, c_tau, s_tau, derivative, sums, j)
    for i in range(nodes):
        shift = _NODES[i] * pitch
        _add_sums(sums, i, first, last, centre, shift, big_r, sdd, c_tau, s_tau, c_b, s_b, row, derivative)


@njit(fastmath=_FAST, error_model="numpy")
def _disc_distance(u, qx, qy, big_r, u_c, sdd, c_tau, s_tau, c_b, s_b, out):
    """Compute the signed distance of the disc's centre to the ray at u (out[7]) and seven derivatives (out[:7])."""
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


@njit(fastmath=_FAST, error_model="numpy")
def _segment(d, r):
    """Integrate 2 sqrt(r^2 - d^2) from 0 to d, d clipped to the disc."""
    d = min(max(d, -r), r)
    return d * math.sqrt(max(r * r - d * d, 0.0)) + r * r * math.asin(d / r)


@njit(fastmath=_FAST, error_model="numpy")
def _disc_moments(chord, d, nx, qx, qy, big_r, row, m):
    """Add a chord's first moments around the COR: its length times its middle, the foot of the perpendicular."""
    ny = math.sqrt(max(1.0 - nx * nx, 0.0))
    row[8, m] += chord * (qx + d * ny)
    row[9, m] += chord * (qy - d * nx - big_r)


@njit(fastmath=_FAST, error_model="numpy")
def _disc_bend(disc, by_t_x, by_t_y, by_ellipse, nx, c_b, s_b, row, m):
    """Add a disc's derivatives by aspect and shear: its centre moves, and it becomes an ellipse of the same area."""
    ny = math.sqrt(max(1.0 - nx * nx, 0.0))
    # The ray's direction in the phantom's axes, which gives the normal's too.
    along_x, along_y = c_b * nx - s_b * ny, s_b * nx + c_b * ny
    hx, hy = 0.5 * disc[0], 0.5 * disc[1]
    row[10, m] += by_t_x * hx - by_t_y * hy + by_ellipse * (along_y * along_y - along_x * along_x)
    row[11, m] += by_t_x * hy + by_t_y * hx - by_ellipse * 2.0 * along_x * along_y


@njit(fastmath=_FAST, error_model="numpy")
def _disc(disc, line_of_cells, t_x, t_y, c_b, s_b, u_first, pitch, cells, rays, row, derivative, left, right):
    """Add one disc to a module's cells of one view; the signed distance grows with u."""
    from_cell, to_cell = int(line_of_cells[0]), int(line_of_cells[1])
    big_r, sdd, u_c, tau = line_of_cells[3], line_of_cells[4], line_of_cells[5], line_of_cells[6]
    c_tau = math.cos(tau)
    s_tau = math.sin(tau)
    x, y = disc[0] + t_x, disc[1] + t_y
    qx, qy = c_b * x + s_b * y, c_b * y - s_b * x + big_r
    r, density = disc[2], disc[3]
    direction = math.atan2(qx, qy)
    half = math.asin(r / math.sqrt(qx * qx + qy * qy))
    low = u_c + sdd * math.sin(direction - half) / math.cos(direction - half + tau)
    high = u_c + sdd * math.sin(direction + half) / math.cos(direction + half + tau)
    first = max(from_cell, _cell_under(low, u_first, pitch, cells))
    last = min(to_cell - 1, _cell_under(high, u_first, pitch, cells))
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
                        slope = density * 2.0 * d / (root * rays)
                        for p in range(7):
                            row[p, m] -= slope * left[p]
                        if derivative > 1:
                            _disc_moments(density * 2.0 * root / rays, d, left[1], qx, qy, big_r, row, m)
                            ellipse = density * (r * r / root - 2.0 * root) / rays
                            _disc_bend(disc, -slope * left[5], -slope * left[6], ellipse, left[1], c_b, s_b, row, m)
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
            if derivative > 1:
                middle, nx = 0.5 * (left[7] + right[7]), 0.5 * (left[1] + right[1])
                _disc_moments(density * mean, middle, nx, qx, qy, big_r, row, m)
                by_t_x = density * ((chord_right - mean) * right[5] - (chord_left - mean) * left[5]) / width
                by_t_y = density * ((chord_right - mean) * right[6] - (chord_left - mean) * left[6]) / width
                ends = min(max(right[7], -r), r) * chord_right - min(max(left[7], -r), r) * chord_left
                _disc_bend(disc, by_t_x, by_t_y, -0.5 * density * ends / width, nx, c_b, s_b, row, m)
        for p in range(8):
            left[p] = right[p]
        area_left = area_right


@njit(fastmath=_FAST, error_model="numpy")
def _by_source_frame(line_of_cells, row):
    """Turn derivatives by a module's own SDD, u_c and tau into derivatives by the source frame's."""
    sdd_by_column, sdd_by_tilt = line_of_cells[8], line_of_cells[9]
    column_by_column, column_by_tilt = line_of_cells[11], line_of_cells[12]
    for m in range(int(line_of_cells[0]), int(line_of_cells[1])):
        by_sdd, by_column = row[2, m], row[3, m]
        row[3, m] = sdd_by_column * by_sdd + column_by_column * by_column
        row[4, m] += sdd_by_tilt * by_sdd + column_by_tilt * by_column


@njit(fastmath=_FAST, error_model="numpy")
def _view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, cells, rays, row, derivative, left, right):
    beta = angles[k] + lines[0, 2]
    c_b = math.cos(beta)
    s_b = math.sin(beta)
    x, y = t_x[k], t_y[k]
    seen, tangents, over = np.empty((len(edges), 12)), np.empty((2, len(edges))), np.empty(len(edges), np.int64)
    centre, sums = np.empty(cells), np.empty((3, SUMS + 1, cells))
    low, high = _seen(edges, lines[0, 3], x, y, c_b, s_b, derivative, seen, tangents)
    for j in range(lines.shape[0]):
        if high > lines[j, 13] and low < lines[j, 14]:
            _edges(seen, tangents, lines[j], c_b, s_b, u_first, pitch, cells, rays, row, derivative, over, centre, sums)
        for i in range(discs.shape[0]):
            _disc(discs[i], lines[j], x, y, c_b, s_b, u_first, pitch, cells, rays, row, derivative, left, right)
        if derivative and lines.shape[0] > 1:
            _by_source_frame(lines[j], row)


@njit(fastmath=_FAST, error_model="numpy")
def _project_view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, out):
    cells = out.shape[1]
    row = np.empty((ROWS, cells))
    row[7] = 0.0
    left = np.empty(8)
    right = np.empty(8)
    _view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, cells, rays, row, 0, left, right)
    for m in range(cells):
        out[k, m] = row[7, m]


@njit(parallel=True, cache=True, fastmath=_FAST, error_model="numpy")
def project(edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, out):
    """Fill out (views, cells) with the projection; rays = 0 averages over the cells."""
    for k in prange(out.shape[0]):
        _project_view(np.int64(k), edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, out)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def project_in_one_thread(edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, out):
    """Do the work of `project` in one thread, where handing work to threads costs more than the work."""
    for k in range(out.shape[0]):
        _project_view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, out)


@njit(parallel=True, cache=True, fastmath=_FAST, error_model="numpy")
def project_with_deformations(edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, out):
    """Fill out (12, views, cells): seven derivatives, the projection; first moments in x and y, aspect, shear."""
    _, views, cells = out.shape
    for kk in prange(views):
        k = np.int64(kk)
        row = np.zeros((ROWS, cells))
        left = np.empty(8)
        right = np.empty(8)
        _view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, cells, rays, row, 2, left, right)
        c, s = math.cos(angles[k] + lines[0, 2]), math.sin(angles[k] + lines[0, 2])
        for m in range(cells):
            x, y = row[8, m], row[9, m]
            row[8, m] = c * x - s * y
            row[9, m] = s * x + c * y
        for p in range(ROWS):
            for m in range(cells):
                out[p, k, m] = row[p, m]


@njit(fastmath=_FAST, error_model="numpy")
def _gram_view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, out):
    cells = sinogram.shape[1]
    row = np.zeros((ROWS, cells))
    left = np.empty(8)
    right = np.empty(8)
    _view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, cells, rays, row, 1, left, right)
    for m in range(cells):
        row[8, m] = 1.0
        row[9, m] = sinogram[k, m]
    if weights.shape[0] > 0:
        for m in range(cells):
            row[TERMS, m] = math.sqrt(weights[k, m])
        for p in range(TERMS):
            for m in range(cells):
                row[p, m] *= row[TERMS, m]
    products_of_rows(row, TERMS, out[k])


@njit(fastmath=_FAST, error_model="numpy")
def products_of_rows(row, count, products):
    """Fill products (count, count) with the rows' inner products; `ROWS_AT_ONCE` spare rows follow the rows."""
    cells = row.shape[1]
    for p in range(0, count, 2):
        for q in range(0, p + 2, ROWS_AT_ONCE):
            a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = 0.0
            for m in range(cells):
                a, b = row[p, m], row[p + 1, m]
                a0 += a * row[q, m]
                a1 += a * row[q + 1, m]
                a2 += a * row[q + 2, m]
                a3 += a * row[q + 3, m]
                b0 += b * row[q, m]
                b1 += b * row[q + 1, m]
                b2 += b * row[q + 2, m]
                b3 += b * row[q + 3, m]
            for i, a, b in ((0, a0, b0), (1, a1, b1), (2, a2, b2), (3, a3, b3)):
                if q + i <= p:
                    products[p, q + i] = products[q + i, p] = a
                if q + i <= p + 1 < count:
                    products[p + 1, q + i] = products[q + i, p + 1] = b


@njit(parallel=True, cache=True, fastmath=_FAST, error_model="numpy")
def gram(edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, out):
    """Fill out (views, 10, 10) with each view's inner products of: seven derivatives of p, p, 1, sinogram.

    weights (views, cells) multiply each cell's products; an empty array gives equal weights.
    """
    for k in prange(sinogram.shape[0]):
        _gram_view(np.int64(k), edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, out)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def gram_in_one_thread(edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, out):
    """Do the work of `gram` in one thread, where handing work to threads costs more than the work."""
    for k in range(sinogram.shape[0]):
        _gram_view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays, sinogram, weights, out)
