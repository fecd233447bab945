"""Kernels of the projected quasi-Newton descent: several problems side by side, (problem, pixel), one thread each.

`which` holds the indices of the problems of a call; arrays (named, pixels) have a row for each of them, arrays
(problems, pixels) one for every problem. A pixel stays where it is at the bound and its gradient pushes outwards.
"""

import numpy as np
from numba import njit, prange

_FAST = {"contract", "nsz", "reassoc", "nnan", "ninf"}


@njit(inline="always")
def _add_then_dot(q, factor, vector, other):
    """Do q += factor * vector, and then q . other, in one pass."""
    factor = np.float32(factor)
    total = 0.0
    for p in range(q.size):
        q[p] += factor * vector[p]
        total += q[p] * other[p]
    return total


@njit(inline="always")
def _at_bound(x, gradient, low):
    return x <= low and gradient > np.float32(0.0)


@njit(parallel=True, cache=True, fastmath=_FAST)
def weigh(projected, lines, weights, which):
    """Turn projections A x (named, views, cells) into weights (A x - y), in place; 1/2 sum weights (A x - y)^2 of each.

    lines and weights have a sinogram for each problem, or one for all.
    """
    named, views, cells = projected.shape
    values = np.zeros((named, views))
    for task in prange(named * views):
        b, k = np.int64(task) // views, np.int64(task) % views
        line, weight = lines[min(which[b], len(lines) - 1), k], weights[min(which[b], len(weights) - 1), k]
        one, total = projected[b, k], np.float32(0.0)
        for c in range(cells):
            residual = one[c] - line[c]
            one[c] = weight[c] * residual
            total += one[c] * residual
        values[b, k] = 0.5 * total
    return values.sum(axis=1)


@njit(parallel=True, cache=True, fastmath=_FAST)
def first_recursion(which, x, gradient, lower, scaling, steps, changes, products, used, newest, taken, out):
    """The first loop of the two-loop recursion (Nocedal and Wright 2006, algorithm 7.4), times scaling, into out.

    x, gradient and scaling are (problems, pixels), out (named, pixels); the histories steps and changes (problems,
    memory, pixels) are rings, with products (problems, memory) = s . y. Fills taken (problems, memory).
    """
    memory = steps.shape[1]
    low = np.float32(lower)
    for bb in prange(which.size):
        b = np.int64(bb)
        w = which[b]
        q, s, y = out[b], steps[w], changes[w]
        for p in range(q.size):
            q[p] = np.float32(0.0) if _at_bound(x[w, p], gradient[w, p], low) else gradient[w, p]
        count = used[w]
        h = newest[w]
        dot = _add_then_dot(q, 0.0, q, s[h])
        for back in range(count):
            taken[w, h] = dot / products[w, h]
            previous = (h - 1 + memory) % memory
            following = s[previous] if back < count - 1 else y[h]
            dot = _add_then_dot(q, -taken[w, h], y[h], following)
            h = previous
        for p in range(q.size):
            q[p] *= scaling[w, p]


@njit(parallel=True, cache=True, fastmath=_FAST)
def second_recursion(which, x, gradient, lower, scaling, scales, steps, changes, products, used, newest, taken, out):
    """The second loop, in place, after the preconditioner: -H g, zero at the bound."""
    memory = steps.shape[1]
    low = np.float32(lower)
    for bb in prange(which.size):
        b = np.int64(bb)
        w = which[b]
        q, s, y = out[b], steps[w], changes[w]
        count = used[w]
        h = (newest[w] - count + 1 + memory) % memory
        scale = np.float32(scales[w])
        dot = 0.0
        for p in range(q.size):
            q[p] *= scale * scaling[w, p]
            dot += q[p] * y[h, p]
        for _ in range(count):
            following = (h + 1) % memory
            dot = _add_then_dot(q, taken[w, h] - dot / products[w, h], s[h], y[following])
            h = following
        for p in range(q.size):
            q[p] = np.float32(0.0) if _at_bound(x[w, p], gradient[w, p], low) else -q[p]


@njit(parallel=True, cache=True, fastmath=_FAST)
def move(which, rows, x, direction, gradient, lengths, lower, out):
    """Fill out (named, pixels) with max(x + length direction[row], lower); returns gradient . (out - x) of each."""
    gains = np.zeros(which.size)
    low = np.float32(lower)
    for bb in prange(which.size):
        b = np.int64(bb)
        w, row, length = which[b], rows[b], np.float32(lengths[b])
        total = 0.0
        for p in range(x.shape[1]):
            new = max(x[w, p] + length * direction[row, p], low)
            total += gradient[w, p] * (new - x[w, p])
            out[b, p] = new
        gains[b] = total
    return gains


@njit(parallel=True, cache=True, fastmath=_FAST)
def accept(which, rows, moved, slope, x, gradient, newest, steps, changes, products, used):
    """Go to moved[row], where the gradient is slope[row]; the step becomes history where it shows upward curvature."""
    memory = steps.shape[1]
    for bb in prange(which.size):
        b = np.int64(bb)
        w, row = which[b], rows[b]
        h = (newest[w] + 1) % memory
        s, y = steps[w, h], changes[w, h]
        sy, yy = 0.0, 0.0
        for p in range(s.size):
            s[p] = moved[row, p] - x[w, p]
            y[p] = slope[row, p] - gradient[w, p]
            sy += s[p] * y[p]
            yy += y[p] * y[p]
            x[w, p] = moved[row, p]
            gradient[w, p] = slope[row, p]
        if sy > 1e-10 * yy and sy > 0.0:
            products[w, h] = sy
            newest[w], used[w] = h, min(used[w] + 1, memory)
        else:
            # The ring's oldest entry is overwritten already: forget it.
            used[w] = min(used[w], memory - 1)
