"""Projected limited-memory quasi-Newton descent for several images in parallel."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.reconstruction.iterative import _descent_numba as kernels

Images = NDArray[np.float32]
Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Shape = tuple[int, ...]
# Objective (named,) and gradient (named, n, n) of images (named, n, n); the indices say which problems they belong to.
Objective = Callable[[Images, Indices], tuple[Floats, Images]]
# Called after each iteration with the number done and the largest number allowed.
OnIteration = Callable[[int, int], None]

MEMORY = 6
# A step must gain this share of the gain that the slope predicts (Nocedal and Wright 2006, section 3.1) ...
ARMIJO = 1e-4
# ... less the rounding of the objective in single precision.
ROUNDING = 1e-7
SHRINK = 0.4
SHORTEST = 1e-8
# Slow steps come in runs: a descent has converged when this many iterations together gain too little.
WINDOW = 8
# Iterations after which the preconditioner is updated to the images.
# This and WINDOW: benchmarks/iterative.py at 3ab7f653.
REFRESH = 4
# First iterations after each of which the preconditioner's size is updated: a warm start then takes shorter steps.
SIZED = 3


class Preconditioner(Protocol):
    """An approximation of an objective's inverse Hessian: scaling * smoothed(scaling * gradient)."""

    def scaling(self, images: Images, which: Indices) -> Images:
        """Return a factor for each pixel at these images (named, n, n); positive."""

    def smoothed(self, images: Images, which: Indices) -> Images:
        """Apply a fixed symmetric positive definite operator to images (named, n, n)."""


@dataclass(frozen=True)
class Minimum:
    """End of a descent."""

    images: Images  # (problems, n, n) float32
    values: Floats  # (problems,): the objective at the images
    iterations: Indices  # (problems,) int64
    converged: NDArray[np.bool_]  # (problems,) bool

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remedy for problems that had not converged."""
        late = int((~self.converged).sum())
        if not late:
            return ()
        return (f"{late} of {self.converged.size} slices were still improving when the iterations ran out: allow more",)


class _History:
    """Steps and changes of gradient, a ring for each problem."""

    def __init__(self, problems: int, shape: Shape) -> None:
        self.shape = shape
        pixels = math.prod(shape)
        # Not zeroed: the part of a ring that is not filled yet is never read.
        self.steps = np.empty((problems, MEMORY, pixels), np.float32)
        self.changes = np.empty_like(self.steps)
        self.products = np.ones((problems, MEMORY, MEMORY))
        self.taken = np.zeros((problems, MEMORY))
        # The preconditioner's scaling, and a factor for each problem.
        self.scaling = np.ones((problems, pixels), np.float32)
        self.scales = np.ones(problems)
        self.used = np.zeros(problems, np.int64)
        self.newest = np.full(problems, MEMORY - 1, np.int64)

    def scale(self, preconditioner: Preconditioner | None, which: Indices) -> None:
        """Scale the preconditioner to the size that the last change of gradient shows, s . y / y . H y."""
        with_steps = which[self.used[which] > 0]
        if with_steps.size == 0:
            return
        newest = self.newest[with_steps]
        change = self.changes[with_steps, newest] * self.scaling[with_steps]
        smoothed = change
        if preconditioner is not None:
            smoothed = preconditioner.smoothed(change.reshape(-1, *self.shape), with_steps).reshape(change.shape)
        self.scales[with_steps] = self.products[with_steps, newest, newest] / np.vecdot(change, smoothed)


def minimise(
    objective: Objective,
    start: Images,
    *,
    lower: float,
    iterations: int,
    tolerance: float,
    window: int = WINDOW,
    preconditioner: Preconditioner | None = None,
    first_scale: float = 1.0,
    on_iteration: OnIteration | None = None,
) -> Minimum:
    """Minimise each problem's objective over images with every pixel at or above `lower` (-inf for no bound).

    Pixels at the bound whose gradient points outwards stay there, the other pixels take a quasi-Newton step that is
    bent along the bound (Bertsekas 1982, two-metric projection). Each problem has its own history, step length and end.

    `start` (problems, n, n) or (problems, slices, n, n) float32: start images; all slices of a problem share one step
    length and one end.
    """
    problems, shape = len(start), start.shape[1:]
    x = np.maximum(start, np.float32(lower)).reshape(problems, -1)
    every = np.arange(problems, dtype=np.int64)
    values, gradient = _evaluate(objective, x, every, shape)
    history = _History(problems, shape)
    history.scales *= first_scale
    if preconditioner is None:
        # Without curvature, the first step should gain a thousandth of the objective; a little where that is zero.
        steepness = np.maximum(np.einsum("bp,bp->b", gradient, gradient, dtype=np.float64), 1e-300)
        history.scales = np.maximum(1e-3 * np.abs(values), 1e-6 * np.sqrt(steepness)) / steepness
    past = np.full((window, problems), np.inf)
    done = np.zeros(problems, np.int64)
    converged = np.zeros(problems, bool)
    for iteration in range(iterations):
        active = every[~converged]
        if active.size == 0:
            break
        past[iteration % window] = values
        if preconditioner is not None and iteration % REFRESH == 0:
            history.scaling[active] = preconditioner.scaling(x[active].reshape(-1, *shape), active).reshape(
                active.size, -1
            )
        if preconditioner is None or iteration % REFRESH == 0 or iteration < SIZED:
            history.scale(preconditioner, active)
        _step(objective, preconditioner, history, x, gradient, values, active, lower)
        done[active] = iteration + 1
        converged[active] = past[(iteration + 1) % window, active] - values[active] < tolerance * np.abs(values[active])
        if on_iteration is not None:
            on_iteration(iteration + 1, iterations)
    return Minimum(x.reshape(start.shape), values, done, converged)


def _evaluate(objective: Objective, x: Images, which: Indices, shape: Shape) -> tuple[Floats, Images]:
    values, gradient = objective(x.reshape(-1, *shape), which)
    return values, gradient.reshape(len(x), -1)


def _step(
    objective: Objective,
    preconditioner: Preconditioner | None,
    history: _History,
    x: Images,
    gradient: Images,
    values: Floats,
    active: Indices,
    lower: float,
) -> None:
    """Take one accepted step of each active problem, to new images, gradients and values."""
    rings = history.steps, history.changes, history.products, history.used, history.newest, history.taken
    direction = np.empty((active.size, x.shape[1]), np.float32)
    kernels.first_recursion(active, x, gradient, lower, history.scaling, *rings, direction)
    if preconditioner is not None:
        direction = preconditioner.smoothed(direction.reshape(-1, *history.shape), active).reshape(direction.shape)
    kernels.second_recursion(active, x, gradient, lower, history.scaling, history.scales, *rings, direction)
    lengths = np.ones(active.size)
    trying = np.arange(active.size)
    while trying.size:
        which = active[trying]
        trial = np.empty((trying.size, x.shape[1]), np.float32)
        predicted = kernels.move(which, trying, x, direction, gradient, lengths[trying], lower, trial)
        value, slope = _evaluate(objective, trial, which, history.shape)
        enough = values[which] + ARMIJO * predicted + ROUNDING * np.abs(values[which])
        lengths[trying] *= SHRINK
        short = (value > enough) & (lengths[trying] > SHORTEST)
        taken = np.flatnonzero(~short)
        kernels.accept(
            which[taken], taken, trial, slope, x, gradient, history.newest, history.steps, history.changes,
            history.products, history.used,
        )  # fmt: skip
        values[which[taken]] = value[taken]
        trying = trying[short]
