"""Kernels of the projected quasi-Newton descent: several problems in parallel, (problem, pixel).

`which` holds the indices of the problems of a call; arrays (named, pixels) have a row for each of these problems,
arrays (problems, pixels) one for every problem. A pixel stays where it is if it is at the bound and its gradient points
outwards.

A thread takes a band of pixels at a time, so that few large problems keep all threads busy as well. The steps s and the
changes of gradient y are rings (problems, memory, pixels). Each two-loop recursion needs the inner products of a vector
with a whole ring at once, and the products s_i . y_j (problems, memory, memory), which `accept` keeps (Chen, Wang and
Zhou 2014, "Large-scale L-BFGS using MapReduce").
"""

import numpy as np
from numba import njit, prange

_FAST = {"contract", "nsz", "reassoc", "nnan", "ninf"}
# Pixels of a band: with a vector of them in the first-level cache. Its inner products are in single precision.
_BAND = 4096


@njit(inline="always")
def _band(task, pixels):
    """Return the row among the named problems, the band's number, and its pixels."""
    bands = (pixels + _BAND - 1) // _BAND
    first = task % bands * _BAND
    return task // bands, task % bands, slice(first, min(first + _BAND, pixels))


@njit(inline="always")
def _tasks(named, pixels):
    return named * ((pixels + _BAND - 1) // _BAND)


@njit(inline="always")
def _dot(one, other):
    total = np.float32(0.0)
    for p in range(one.size):
        total += one[p] * other[p]
    return total


@njit(inline="always")
def _add(q, factor, vector):
    factor = np.float32(factor)
    for p in range(q.size):
        q[p] += factor * vector[p]


@njit(inline="always")
def _at_bound(x, gradient, low):
    return x <= low and gradient > np.float32(0.0)


@njit(parallel=True, cache=True, fastmath=_FAST)
def weigh(projected, lines, weights, which):
    """Turn projections A x (named, views, cells) into weights (A x - y), in place; return 1/2 sum weights (A x - y)^2.

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
    """Run the first loop of the two-loop recursion (Nocedal and Wright 2006, algorithm 7.4), times scaling, into out.

    x, gradient and scaling are (problems, pixels), out (named, pixels). Fills taken (problems, memory).
    """
    memory, pixels = steps.shape[1:]
    low = np.float32(lower)
    tasks = _tasks(which.size, pixels)
    dots = np.zeros((which.size, tasks // which.size, memory))
    for task in prange(tasks):
        b, number, part = _band(np.int64(task), pixels)
        w = which[b]
        q, here, slope = out[b, part], x[w, part], gradient[w, part]
        for p in range(q.size):
            q[p] = np.float32(0.0) if _at_bound(here[p], slope[p], low) else slope[p]
        for back in range(used[w]):
            h = (newest[w] - back + memory) % memory
            dots[b, number, h] = _dot(q, steps[w, h, part])
    for b in range(which.size):
        w = which[b]
        for back in range(used[w]):
            h = (newest[w] - back + memory) % memory
            dot = dots[b, :, h].sum()
            for later in range(back):
                j = (newest[w] - later + memory) % memory
                dot -= taken[w, j] * products[w, h, j]
            taken[w, h] = dot / products[w, h, h]
    for task in prange(tasks):
        b, _, part = _band(np.int64(task), pixels)
        w = which[b]
        q, factor = out[b, part], scaling[w, part]
        for back in range(used[w]):
            h = (newest[w] - back + memory) % memory
            _add(q, -taken[w, h], changes[w, h, part])
        for p in range(q.size):
            q[p] *= factor[p]


@njit(parallel=True, cache=True, fastmath=_FAST)
def second_recursion(which, x, gradient, lower, scaling, scales, steps, changes, products, used, newest, taken, out):
    """Run the second loop, in place, after the preconditioner: -H g, zero at the bound."""
    memory, pixels = steps.shape[1:]
    low = np.float32(lower)
    tasks = _tasks(which.size, pixels)
    dots = np.zeros((which.size, tasks // which.size, memory))
    for task in prange(tasks):
        b, number, part = _band(np.int64(task), pixels)
        w = which[b]
        q, factor, scale = out[b, part], scaling[w, part], np.float32(scales[w])
        for p in range(q.size):
            q[p] *= scale * factor[p]
        for back in range(used[w]):
            h = (newest[w] - back + memory) % memory
            dots[b, number, h] = _dot(q, changes[w, h, part])
    for b in range(which.size):
        w = which[b]
        for back in range(used[w] - 1, -1, -1):
            h = (newest[w] - back + memory) % memory
            dot = dots[b, :, h].sum()
            for earlier in range(used[w] - 1, back, -1):
                j = (newest[w] - earlier + memory) % memory
                dot += taken[w, j] * products[w, j, h]
            taken[w, h] -= dot / products[w, h, h]
    for task in prange(tasks):
        b, _, part = _band(np.int64(task), pixels)
        w = which[b]
        q, here, slope = out[b, part], x[w, part], gradient[w, part]
        for back in range(used[w]):
            h = (newest[w] - back + memory) % memory
            _add(q, taken[w, h], steps[w, h, part])
        for p in range(q.size):
            q[p] = np.float32(0.0) if _at_bound(here[p], slope[p], low) else -q[p]


@njit(parallel=True, cache=True, fastmath=_FAST)
def move(which, rows, x, direction, gradient, lengths, lower, out):
    """Fill out (named, pixels) with max(x + length direction[row], lower); return gradient . (out - x) of each row."""
    pixels = x.shape[1]
    low = np.float32(lower)
    tasks = _tasks(which.size, pixels)
    gains = np.empty((which.size, tasks // which.size))
    for task in prange(tasks):
        b, number, part = _band(np.int64(task), pixels)
        w, length = which[b], np.float32(lengths[b])
        here, along, slope, to = x[w, part], direction[rows[b], part], gradient[w, part], out[b, part]
        total = np.float32(0.0)
        for p in range(to.size):
            new = max(here[p] + length * along[p], low)
            total += slope[p] * (new - here[p])
            to[p] = new
        gains[b, number] = total
    return gains.sum(axis=1)


@njit(parallel=True, cache=True, fastmath=_FAST)
def accept(which, rows, moved, slope, x, gradient, newest, steps, changes, products, used):
    """Move to moved[row] with the gradient slope[row]; a step with upward curvature is added to the history."""
    memory, pixels = steps.shape[1:]
    tasks = _tasks(which.size, pixels)
    # Products with each entry of the ring: the step . changes, the change . steps; and the change . itself.
    dots = np.zeros((which.size, tasks // max(which.size, 1), 3, memory))
    for task in prange(tasks):
        b, number, part = _band(np.int64(task), pixels)
        w, row = which[b], rows[b]
        new = (newest[w] + 1) % memory
        s, y = steps[w, new, part], changes[w, new, part]
        here, there, slope_here, slope_there = x[w, part], moved[row, part], gradient[w, part], slope[row, part]
        for p in range(s.size):
            s[p] = there[p] - here[p]
            y[p] = slope_there[p] - slope_here[p]
            here[p] = there[p]
            slope_here[p] = slope_there[p]
        one = dots[b, number]
        one[0, new], one[2, new] = _dot(s, y), _dot(y, y)
        for back in range(min(used[w], memory - 1)):
            h = (newest[w] - back + memory) % memory
            one[0, h], one[1, h] = _dot(s, changes[w, h, part]), _dot(y, steps[w, h, part])
    for b in range(which.size):
        w, total = which[b], dots[b].sum(axis=0)
        new = (newest[w] + 1) % memory
        if total[0, new] > 1e-10 * total[2, new] and total[0, new] > 0.0:
            products[w, :, new] = total[1]
            products[w, new] = total[0]
            newest[w], used[w] = new, min(used[w] + 1, memory)
        else:
            # The ring's oldest entry is overwritten already: drop it.
            used[w] = min(used[w], memory - 1)
