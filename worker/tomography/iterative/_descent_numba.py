"""Kernels of the projected quasi-Newton descent: several problems side by side, (problem, pixel), one thread each."""

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


@njit(parallel=True, cache=True, fastmath=_FAST)
def towards_first_guess(which, gradient, held, shares, steps, changes, products, used, newest, taken, out):
    """The first half of the two-loop recursion (Nocedal and Wright 2006, algorithm 7.4), times shares, into out.

    gradient, held and out are (named, pixels), shares (problems, pixels); the histories steps and changes
    (problems, memory, pixels) are rings, with products (problems, memory) = s . y. Fills taken (problems, memory).
    """
    memory = steps.shape[1]
    for bb in prange(which.size):
        b = np.int64(bb)
        w = which[b]
        q, s, y = out[b], steps[w], changes[w]
        for p in range(q.size):
            q[p] = np.float32(0.0) if held[b, p] else gradient[b, p]
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
            q[p] *= shares[w, p]


@njit(parallel=True, cache=True, fastmath=_FAST)
def directions(which, held, shares, scales, steps, changes, products, used, newest, taken, out):
    """The second half, in place, from what the first guess of H made of the first half: -H g, zero where held."""
    memory = steps.shape[1]
    for bb in prange(which.size):
        b = np.int64(bb)
        w = which[b]
        q, s, y = out[b], steps[w], changes[w]
        count = used[w]
        h = (newest[w] - count + 1 + memory) % memory
        scale = np.float32(scales[w])
        dot = 0.0
        for p in range(q.size):
            q[p] *= scale * shares[w, p]
            dot += q[p] * y[h, p]
        for _ in range(count):
            following = (h + 1) % memory
            dot = _add_then_dot(q, taken[w, h] - dot / products[w, h], s[h], y[following])
            h = following
        for p in range(q.size):
            q[p] = np.float32(0.0) if held[b, p] else -q[p]


@njit(parallel=True, cache=True, fastmath=_FAST)
def move(x, direction, gradient, lengths, lower, out):
    """Fill out with max(x + length direction, lower); returns gradient . (out - x) of each problem."""
    gains = np.zeros(lengths.size)
    for bb in prange(lengths.size):
        b = np.int64(bb)
        length, low = np.float32(lengths[b]), np.float32(lower)
        total = 0.0
        for p in range(x.shape[1]):
            new = max(x[b, p] + length * direction[b, p], low)
            total += gradient[b, p] * (new - x[b, p])
            out[b, p] = new
        gains[b] = total
    return gains


@njit(parallel=True, cache=True, fastmath=_FAST)
def remember(which, x, x_new, gradient, gradient_new, newest, steps, changes, products, used):
    """Put each problem's step and change of gradient into its history, where they show upward curvature."""
    memory = steps.shape[1]
    for bb in prange(which.size):
        b = np.int64(bb)
        w = which[b]
        h = (newest[w] + 1) % memory
        s, y = steps[w, h], changes[w, h]
        sy, yy = 0.0, 0.0
        for p in range(s.size):
            s[p] = x_new[b, p] - x[b, p]
            y[p] = gradient_new[b, p] - gradient[b, p]
            sy += s[p] * y[p]
            yy += y[p] * y[p]
        if sy > 1e-10 * yy and sy > 0.0:
            products[w, h] = sy
            newest[w], used[w] = h, min(used[w] + 1, memory)
        else:
            # The ring's oldest entry is overwritten already: forget it.
            used[w] = min(used[w], memory - 1)
