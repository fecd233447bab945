"""Kernel of the joint fit. It only loops; `normal_equations.py` documents and allocates.

All derivatives of one view stay in the processor's cache: only inner products of the derivatives are written to memory.
"""

import math

import numpy as np
from numba import njit, prange

from sawmill_tomography.calibration.joint_fit.scan_model import OF_WOOD, Term
from sawmill_tomography.projection._analytic_numba import _FAST, PARAMETERS, ROWS, ROWS_AT_ONCE, _view, products_of_rows

# One thread takes the views of a block one after another, so the sums do not depend on the number of threads.
BLOCK = 16

TERMS, _U_C = int(OF_WOOD[0]), int(Term.U_C)
_GAIN, _OFFSET = int(Term.GAIN), int(Term.OFFSET)
_HARDENING, _CUBIC = int(Term.HARDENING), int(Term.HARDENING_CUBIC)
_GRADIENT_X, _GRADIENT_Y = int(Term.GRADIENT_X), int(Term.GRADIENT_Y)
_ASPECT, _CORNERS, _BLUR, _EXPOSURE = int(Term.ASPECT), int(Term.CORNERS), int(Term.BLUR), int(Term.EXPOSURE)
_SLOPE, _CURVATURE, _SCATTER = int(Term.SLOPE), int(Term.CURVATURE), int(Term.SCATTER)


@njit(fastmath=_FAST, error_model="numpy")
def _of_line_integrals(raw, gain, cosine, sine, sizes, chain, row):
    """Fill the rows before the exposure's from the rows of `_view`, without blur."""
    cells = raw.shape[1]
    square, cubic, by_x, by_y = sizes[_HARDENING], sizes[_CUBIC], sizes[_GRADIENT_X], sizes[_GRADIENT_Y]
    for m in range(cells):
        length = raw[PARAMETERS, m]
        chain[m] = gain * (1.0 + 2.0 * square * length + 3.0 * cubic * length * length)
        row[_OFFSET, m] = 1.0
    for p in range(PARAMETERS):
        for m in range(cells):
            row[p, m] = raw[p, m] * chain[m]
    for m in range(cells):
        length = raw[PARAMETERS, m]
        row[_HARDENING, m] = gain * length * length
        row[_CUBIC, m] = gain * length * length * length
    for m in range(cells):
        row[_GRADIENT_X, m] = gain * (cosine * raw[8, m] - sine * raw[9, m])
        row[_GRADIENT_Y, m] = gain * (sine * raw[8, m] + cosine * raw[9, m])
    for m in range(cells):
        length = raw[PARAMETERS, m]
        bent = length + square * length * length + cubic * length * length * length
        x, y = cosine * raw[8, m] - sine * raw[9, m], sine * raw[8, m] + cosine * raw[9, m]
        row[_GAIN, m] = bent + by_x * x + by_y * y
    for p in range(2):
        for m in range(cells):
            row[_ASPECT + p, m] = raw[10 + p, m] * chain[m]


@njit(fastmath=_FAST, error_model="numpy")
def _add_turn(of_turn, weight, gain, from_counts, share, row, soft):
    """Add the rows of one turn by their weight, times the intensity that the detector averages where it counts."""
    for m in range(soft.size):
        share[m] = weight * math.exp(-gain * of_turn[_GAIN, m]) if from_counts else weight
        soft[m] += share[m]
    for p in range(_CORNERS):
        for m in range(soft.size):
            row[p, m] += share[m] * of_turn[p, m]


@njit(fastmath=_FAST, error_model="numpy")
def _soften(line, first, last, taps, padded):
    """Blur a line (cells,) that is 0 outside a window in place, with reflection at both ends; return the wider window.

    Values outside the window are not read.
    """
    cells, reach = line.size, taps.size // 2
    start, stop = max(first - reach, 0), min(last + reach, cells)
    for m in range(start - reach, stop + reach):
        at = m % (2 * cells)
        at = min(at, 2 * cells - 1 - at)
        padded[m - start + reach] = line[at] if first <= at < last else 0.0
    for m in range(start, stop):
        line[m] = 0.0
    for j in range(taps.size):
        for m in range(start, stop):
            line[m] += taps[j] * padded[m - start + j]
    return start, stop


@njit(fastmath=_FAST, error_model="numpy")
def _blur_row(line, first, last, intensity, soft, taps, padded):
    """Blur the change of intensity that a line makes, where the blur leaves `soft` of an intensity, as `_soften`."""
    for m in range(first, last):
        line[m] *= intensity[m]
    start, stop = _soften(line, first, last, taps, padded)
    for m in range(start, stop):
        line[m] /= soft[m]
    return start, stop


@njit(fastmath=_FAST, error_model="numpy")
def _blur_rows(exposed, taps, from_counts, row, of_patches, windows):
    """Blur the rows, and those of patches; where there are counts, blur the changes of intensity that they make."""
    cells = exposed.size
    padded, intensity = np.empty(cells + taps.size), np.ones(cells)
    if from_counts:
        for m in range(cells):
            intensity[m] = math.exp(-exposed[m])
    soft = intensity.copy()
    _soften(soft, 0, cells, taps, padded)
    for p in range(_EXPOSURE + 1):
        if p not in (_OFFSET, _BLUR):
            _blur_row(row[p], 0, cells, intensity, soft, taps, padded)
    for n in range(windows.shape[0]):
        windows[n] = _blur_row(of_patches[n], windows[n, 0], windows[n, 1], intensity, soft, taps, padded)


@njit(fastmath=_FAST, error_model="numpy")
def _by_blur(blurred, from_counts, row):
    """Fill the row of the blur's squared width: half the second difference, for intensities less the squared first."""
    cells = blurred.size
    for m in range(cells):
        before, after = blurred[max(m - 1, 0)], blurred[min(m + 1, cells - 1)]
        first = 0.5 * (after - before) if from_counts else 0.0
        row[_BLUR, m] = 0.5 * (after - 2.0 * blurred[m] + before - first * first)


@njit(fastmath=_FAST, error_model="numpy")
def _of_intensities(around, wide, lagging, added, row):
    """Divide the rows by the measured intensity, and fill the rows of scatter and lag, which add to a cell's own."""
    cells = row.shape[1]
    if added.any():
        for p in range(_SLOPE):
            for m in range(cells):
                row[p, m] /= 1.0 + added[m]
    for m in range(cells):
        row[_SCATTER, m] = -around[m] / (1.0 + added[m])
        row[_SCATTER + 1, m] = -wide[m] / (1.0 + added[m])
        row[_SCATTER + 2, m] = -lagging[m] / (1.0 + added[m])


@njit(fastmath=_FAST, error_model="numpy")
def _window(line):
    """Return the first cell of a line (cells,) that is not 0, and the one behind the last."""
    first, last = 0, line.size
    while first < last and line[first] == 0.0:
        first += 1
    while last > first and line[last - 1] == 0.0:
        last -= 1
    return first, last


@njit(fastmath=_FAST, error_model="numpy")
def _products_of_windows(row, count, windows, of_patches, grams, scores):
    """Fill the inner products of lines (patches, cells) that are 0 outside windows (patches, 2), and with the rows.

    The rows before `count` are those of the other terms; the row `count` is the residual.
    """
    for n in range(windows.shape[0]):
        first, last = windows[n]
        own = grams.shape[0] - windows.shape[0] + n
        for p in range(count + 1):
            total = 0.0
            for m in range(first, last):
                total += row[p, m] * of_patches[n, m]
            if p < count:
                grams[own, p] = grams[p, own] = total
            else:
                scores[own] = total
        for q in range(n + 1):
            total = 0.0
            for m in range(max(first, windows[q, 0]), min(last, windows[q, 1])):
                total += of_patches[q, m] * of_patches[n, m]
            grams[own, own - n + q] = grams[own - n + q, own] = total


@njit(parallel=True, cache=True, fastmath=_FAST, error_model="numpy")
def inner_products(
    geometry,
    turned,
    of_turns,
    exposure,
    corner_edges,
    gain,
    sizes,
    exposed,
    blurred,
    taps,
    intensities,
    weights,
    residual,
    stripes,
    kept_terms,
    by_column,
    by_wood,
    patch_edges,
    patches,
    products,
):
    """Fill the views' inner products, and the sums over views.

    geometry : tuple of the first arguments of the analytic projection's kernels
    turned, of_turns : (turns, views) angles over which a view is exposed, and the (turns,) weight of each
    exposure : (views, cells) derivative by the exposure
    corner_edges : (edges, 5) of the pieces that corners lose, with the density that makes them the derivative
    gain : (views,); sizes : (terms,)
    exposed, blurred : (views, cells)
    taps : (2 n + 1,) weights of the blur; empty where there is none
    intensities : four times (views, cells): scatter from around and from the whole view, lag, and the sum of what is
        added; (0, cells) where the line integrals were not made from counts
    weights, residual : (views, cells); stripes : (cells,) the part of the residual that all views share
    kept_terms : terms whose weighted rows are kept
    by_column : (rows, cells) factors of the derivative by u_c that give the rows of the detector's modules
    by_wood : (rows, views, cells) derivatives by further terms
    patch_edges : (edges, 5) of the wood's patches; patches : (patches + 1,) where the edges of each begin
    products : grams (views, rows, rows), scores (views, rows), sums (blocks, rows, cells) of the weighted rows,
        of_column (blocks, rows + 1, cells) products of the weighted rows and of the residual with the derivative by
        u_c, kept (kept terms, views, cells), neighbours (views, 2): sum and sum of squares of neighbouring cells'
        products; the rows of the detector's modules, of the further terms and of the patches follow those of the terms
    """
    edges, discs, lines, t_x, t_y, angles, u_first, pitch, rays = geometry
    grams, scores, sums, of_column, kept, neighbours = products
    views, cells = residual.shape
    around, wide, lagging, added = intensities
    from_counts = len(added) > 0
    of_modules, extra = by_column.shape[0], by_column.shape[0] + by_wood.shape[0]
    number = patches.size - 1
    count = TERMS + extra if from_counts or extra or number else _SCATTER
    for block in prange(sums.shape[0]):
        raw, row = np.empty((ROWS, cells)), np.zeros((TERMS + extra + ROWS_AT_ONCE, cells))
        of_rows = np.empty((count + 1, count + 1))
        at, of_turn, left, right = np.empty((ROWS, cells)), np.empty((_CORNERS, cells)), np.empty(8), np.empty(8)
        chain, factors, soft = np.empty(cells), np.empty(cells), np.empty(cells)
        of_patches, windows = np.empty((number, cells)), np.empty((number, 2), np.int64)
        for kk in range(block * BLOCK, min((block + 1) * BLOCK, views)):
            k = np.int64(kk)
            raw[:] = 0.0
            _view(k, edges, discs, lines, t_x, t_y, angles, u_first, pitch, cells, rays, raw, 2, left, right)
            beta = angles[k] + lines[0, 2]
            _of_line_integrals(raw, gain[k], math.cos(beta), math.sin(beta), sizes, chain, row)
            if of_turns.size > 1:
                row[:_CORNERS], soft[:] = 0.0, 0.0
                for n in range(of_turns.size):
                    raw[:] = 0.0
                    _view(k, edges, discs, lines, t_x, t_y, turned[n], u_first, pitch, cells, rays, raw, 2, left, right)
                    beta = turned[n, k] + lines[0, 2]
                    _of_line_integrals(raw, gain[k], math.cos(beta), math.sin(beta), sizes, factors, of_turn)
                    _add_turn(of_turn, of_turns[n], gain[k], from_counts, factors, row, soft)
                row[:_CORNERS] /= soft
            row[_EXPOSURE] = exposure[k]
            at[PARAMETERS] = 0.0
            for n in range(-1, number):
                some = patch_edges[patches[n] : patches[n + 1]] if n >= 0 else corner_edges
                _view(k, some, discs[:0], lines, t_x, t_y, angles, u_first, pitch, cells, rays, at, 0, left, right)
                line, first, last = row[_CORNERS], 0, cells
                if n >= 0:
                    line = of_patches[n]
                    first, last = windows[n] = _window(at[PARAMETERS])
                for m in range(first, last):
                    line[m] = at[PARAMETERS, m] * chain[m]
                    at[PARAMETERS, m] = 0.0
            if taps.size > 0:
                _blur_rows(exposed[k], taps, from_counts, row, of_patches, windows)
            _by_blur(blurred[k], from_counts, row)
            for m in range(cells):
                across = (m + 0.5) / cells - 0.5
                row[_SLOPE, m] = across
                row[_CURVATURE, m] = across * across
            if from_counts:
                _of_intensities(around[k], wide[k], lagging[k], added[k], row)
            for n in range(of_modules):
                for m in range(cells):
                    row[TERMS + n, m] = by_column[n, m] * row[_U_C, m]
            for n in range(of_modules, extra):
                for m in range(cells):
                    row[TERMS + n, m] = by_wood[n - of_modules, k, m]
            for n in range(number):
                if from_counts:
                    for m in range(windows[n, 0], windows[n, 1]):
                        of_patches[n, m] /= 1.0 + added[k, m]
            for m in range(cells):
                chain[m] = math.sqrt(weights[k, m])
                row[count, m] = chain[m] * (residual[k, m] - stripes[m])
            for p in range(count):
                for m in range(cells):
                    row[p, m] *= chain[m]
                    sums[block, p, m] += chain[m] * row[p, m]
            for n in range(number):
                own = TERMS + extra + n
                for m in range(windows[n, 0], windows[n, 1]):
                    of_patches[n, m] *= chain[m]
                    sums[block, own, m] += chain[m] * of_patches[n, m]
                    of_column[block, own, m] += row[_U_C, m] * of_patches[n, m]
            for p in range(count):
                for m in range(cells):
                    of_column[block, p, m] += row[_U_C, m] * row[p, m]
            for m in range(cells):
                of_column[block, TERMS + extra + number, m] += row[_U_C, m] * row[count, m]
            for n in range(kept_terms.size):
                for m in range(cells):
                    kept[n, k, m] = chain[m] * row[kept_terms[n], m]
            total = squares = 0.0
            for m in range(cells - 1):
                product = row[count, m] * row[count, m + 1]
                total += product
                squares += product * product
            neighbours[k, 0], neighbours[k, 1] = total, squares
            products_of_rows(row, count + 1, of_rows)
            for p in range(count):
                scores[k, p] = of_rows[count, p]
                for q in range(count):
                    grams[k, p, q] = of_rows[p, q]
            _products_of_windows(row, count, windows, of_patches, grams[k], scores[k])


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def without_shares(grams, own, share):
    """Return inner products (views, n, n) less the shares (views, n, m) of the rows `own` (m,)."""
    left = np.empty_like(grams)
    for k in range(grams.shape[0]):
        for p in range(grams.shape[1]):
            for q in range(grams.shape[1]):
                left[k, p, q] = grams[k, p, q]
            for o in range(own.size):
                part, row = share[k, p, o], own[o]
                for q in range(grams.shape[1]):
                    left[k, p, q] -= part * grams[k, row, q]
    return left


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def taken_of_modules(taken, by_stripes, u, turn, border):
    """Return what `taken` (rows, cells) takes of information about a gap before each cell, a kink, and between both.

    A kink moves a cell by (u - border) times `turn`. A module before a cell of the first half moves the cells before
    it, with negative sign, and one of the second half those behind (`modules.py`).
    """
    cells = u.size
    found, half = np.zeros((3, cells)), cells // 2
    for n in range(taken.shape[0]):
        for way in range(2):
            gap = kink = apart = gap_stripes = kink_stripes = apart_stripes = 0.0
            for step in range(half + 1 if way == 0 else cells - half - 1):
                # The cells that a module moves are added one by one: before it, or behind it from the last.
                c = step if way == 0 else cells - 1 - step
                m = step - 1 if way == 0 else c
                if m >= 0:
                    sign = -1.0 if way == 0 else 1.0
                    value, stripe = sign * taken[n, m], sign * by_stripes[n, m]
                    gap += value
                    gap_stripes += stripe
                    apart += value * turn[m]
                    apart_stripes += stripe * turn[m]
                    kink += value * turn[m] * u[m]
                    kink_stripes += stripe * turn[m] * u[m]
                moved, moved_stripes = kink - border[c] * apart, kink_stripes - border[c] * apart_stripes
                found[0, c] += gap * (gap - 2.0 * gap_stripes)
                found[1, c] += moved * (moved - 2.0 * moved_stripes)
                found[2, c] += gap * (moved - moved_stripes) - gap_stripes * moved
    return found


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def combined(grams, scores, rows, weights, at):
    """Return the inner products (views, d, d) of combinations of rows, and their scores (views, d) at another point.

    `rows` (n,), of which `weights` (views, d, n) are the combinations and `at` (views, n) the point.
    """
    views, count, n = weights.shape
    products, of_scores = np.empty((views, count, count)), np.empty((views, count))
    line, moved, by = np.empty(n), np.empty(n), np.empty((count, n))
    for k in range(views):
        for p in range(n):
            total = scores[k, rows[p]]
            for q in range(n):
                line[q] = grams[k, rows[p], rows[q]]
                total += line[q] * at[k, q]
            moved[p] = total
            for a in range(count):
                total = 0.0
                for q in range(n):
                    total += line[q] * weights[k, a, q]
                by[a, p] = total
        for a in range(count):
            total = 0.0
            for p in range(n):
                total += weights[k, a, p] * moved[p]
            of_scores[k, a] = total
            for b in range(count):
                total = 0.0
                for p in range(n):
                    total += weights[k, a, p] * by[b, p]
                products[k, a, b] = total
    return products, of_scores


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def largest_power(scores, information, diagonal, blocks):
    """Return the largest sum of squares of scores (views, n): of single views, or of blocks of neighbouring views.

    The scores of single views are multiplied by (diagonal - information)^-1, by Gauss's elimination.
    """
    views, n = scores.shape
    matrix, solved, largest = np.empty((n, n)), np.empty(n), 0.0
    for k in range(views):
        for i in range(n):
            solved[i] = scores[k, i]
            for j in range(n):
                matrix[i, j] = (diagonal if i == j else 0.0) - information[k, i, j]
        for i in range(n):
            for j in range(i + 1, n):
                factor = matrix[j, i] / matrix[i, i]
                solved[j] -= factor * solved[i]
                for q in range(i, n):
                    matrix[j, q] -= factor * matrix[i, q]
        for i in range(n - 1, -1, -1):
            for j in range(i + 1, n):
                solved[i] -= matrix[i, j] * solved[j]
            solved[i] /= matrix[i, i]
            largest += solved[i] * solved[i]
    for count in blocks:
        if count < views:
            power = 0.0
            for block in range(count):
                for i in range(n):
                    total = 0.0
                    for k in range(block * views // count, (block + 1) * views // count):
                        total += scores[k, i]
                    power += total * total
            largest = max(largest, power)
    return largest


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def evidences(information, score, begins, places, unit, tempered, sizes):
    """Return the logarithm of the likelihood of each size of groups against 0, (groups, sizes).

    information (n, n), score (n,) : what other columns leave, which count by `tempered` (groups,)
    begins : (groups + 1,) where the columns of each group begin in places (columns,) and unit (columns,)
    sizes : (groups, sizes) standard deviations of a group's columns, in their units
    """
    found, most = np.empty(sizes.shape), 0
    for g in range(sizes.shape[0]):
        most = max(most, begins[g + 1] - begins[g])
    own, root, solved = np.empty((most, most)), np.empty((most, most)), np.empty(most)
    for g in range(sizes.shape[0]):
        first, width = begins[g], begins[g + 1] - begins[g]
        for i in range(width):
            for j in range(i + 1):
                both = unit[first + i] * unit[first + j]
                own[i, j] = tempered[g] * both * information[places[first + i], places[first + j]]
        for n in range(sizes.shape[1]):
            square, total = sizes[g, n] * sizes[g, n], 0.0
            # Cholesky's factor of 1 + square * own, whose pivots are at least 1 but for rounding.
            for i in range(width):
                at = tempered[g] * unit[first + i] * score[places[first + i]]
                for j in range(i + 1):
                    left = square * own[i, j]
                    for k in range(j):
                        left -= root[i, k] * root[j, k]
                    if j < i:
                        root[i, j] = left / root[j, j]
                        at -= root[i, j] * solved[j]
                    else:
                        root[i, i] = math.sqrt(max(1.0 + left, 1.0))
                solved[i] = at / root[i, i]
                total += 0.5 * square * solved[i] * solved[i] - math.log(root[i, i])
            found[g, n] = total
    return found
