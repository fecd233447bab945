"""Projected limited-memory quasi-Newton descent for several images side by side."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.tomography.iterative import _descent_numba as kernels

Images = NDArray[np.float32]
Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
# Objective (named,) and gradient (named, n, n) of images (named, n, n); the indices say which problems they belong to.
Objective = Callable[[Images, Indices], tuple[Floats, Images]]
# Called after each iteration with the number done and the most there may be.
Progress = Callable[[int, int], None]

MEMORY = 6
# A step must gain this share of what the slope promises (Nocedal and Wright 2006, section 3.1) ...
ARMIJO = 1e-4
# ... less what single precision makes of the objective.
ROUNDING = 1e-7
SHRINK = 0.4
SHORTEST = 1e-8
# Slow steps come in spells: an objective is at rest when this many iterations together gain too little.
SPELL = 8
# Iterations after which the first guess of the inverse curvature follows the images.
REFRESH = 4


class FirstGuess(Protocol):
    """What is known of an objective's inverse curvature beforehand: shares * smoothed(shares * gradient)."""

    def shares(self, images: Images, which: Indices) -> Images:
        """A factor for each pixel at these images (named, n, n); positive."""

    def smoothed(self, images: Images, which: Indices) -> Images:
        """A fixed symmetric positive definite operator on images (named, n, n)."""


@dataclass(frozen=True)
class Minimum:
    """Where the descent ended.

    Attributes
    ----------
    images : (problems, n, n) float32
    values : (problems,) float64
        The objective there.
    iterations : (problems,) int64
    converged : (problems,) bool
        Whether the last iterations gained less than the tolerance, rather than their number running out.
    """

    images: Images
    values: Floats
    iterations: Indices
    converged: NDArray[np.bool_]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to do about problems that were still improving."""
        late = int((~self.converged).sum())
        if not late:
            return ()
        return (f"{late} of {self.converged.size} slices were still improving when the iterations ran out: allow more",)


class _History:
    """Steps and changes of gradient, a ring for each problem."""

    def __init__(self, problems: int, n: int) -> None:
        self.n = n
        self.steps = np.zeros((problems, MEMORY, n * n), np.float32)
        self.changes = np.zeros_like(self.steps)
        self.products = np.ones((problems, MEMORY))
        self.taken = np.zeros((problems, MEMORY))
        # The first guess of the inverse curvature, its shares and a scale for each problem.
        self.shares = np.ones((problems, n * n), np.float32)
        self.scales = np.ones(problems)
        self.used = np.zeros(problems, np.int64)
        self.newest = np.full(problems, MEMORY - 1, np.int64)

    def scale(self, guess: FirstGuess | None, which: Indices) -> None:
        """Bring the first guess to the size that the last change of gradient shows, s . y / y . H y."""
        known = which[self.used[which] > 0]
        change = self.changes[known, self.newest[known]] * self.shares[known]
        if guess is None:
            product = np.einsum("bp,bp->b", change, change, dtype=np.float64)
        else:
            smoothed = guess.smoothed(change.reshape(-1, self.n, self.n), known).reshape(change.shape)
            product = np.einsum("bp,bp->b", change, smoothed, dtype=np.float64)
        self.scales[known] = self.products[known, self.newest[known]] / product


def minimise(
    objective: Objective,
    start: Images,
    *,
    lower: float,
    iterations: int,
    tolerance: float,
    guess: FirstGuess | None = None,
    progress: Progress | None = None,
) -> Minimum:
    """Minimise each problem's objective over images with every pixel at or above `lower` (-inf for no bound).

    Pixels at the bound whose gradient pushes outwards are held, the others take a quasi-Newton step that is bent
    along the bound (Bertsekas 1982, two-metric projection). Each problem has its own history, step length and end.

    Parameters
    ----------
    start : (problems, n, n) float32
    tolerance : float
        A problem is done when SPELL iterations together lower its objective by less than this share of it.
    guess : FirstGuess, optional
        By default the identity.
    """
    problems, n, _ = start.shape
    x = np.maximum(start, np.float32(lower)).reshape(problems, -1)
    every = np.arange(problems, dtype=np.int64)
    values, gradient = _evaluate(objective, x, every, n)
    history = _History(problems, n)
    if guess is None:
        # Without curvature yet, the first step is to gain a thousandth of the objective; a little where that is zero.
        steepness = np.maximum(np.einsum("bp,bp->b", gradient, gradient, dtype=np.float64), 1e-300)
        history.scales = np.maximum(1e-3 * np.abs(values), 1e-6 * np.sqrt(steepness)) / steepness
    past = np.full((SPELL, problems), np.inf)
    done = np.zeros(problems, np.int64)
    converged = np.zeros(problems, bool)
    for iteration in range(iterations):
        active = every[~converged]
        if active.size == 0:
            break
        past[iteration % SPELL] = values
        if guess is not None and iteration % REFRESH == 0:
            history.shares[active] = guess.shares(x[active].reshape(-1, n, n), active).reshape(active.size, -1)
        if guess is None or iteration % REFRESH == 0:
            history.scale(guess, active)
        _step(objective, guess, history, x, gradient, values, active, lower)
        done[active] = iteration + 1
        earlier = past[(iteration + 1) % SPELL, active]
        converged[active] = earlier - values[active] < tolerance * np.abs(values[active])
        if progress is not None:
            progress(iteration + 1, iterations)
    return Minimum(x.reshape(start.shape), values, done, converged)


def _evaluate(objective: Objective, x: Images, which: Indices, n: int) -> tuple[Floats, Images]:
    values, gradient = objective(x.reshape(-1, n, n), which)
    return values, gradient.reshape(len(x), -1)


def _step(
    objective: Objective,
    guess: FirstGuess | None,
    history: _History,
    x: Images,
    gradient: Images,
    values: Floats,
    active: Indices,
    lower: float,
) -> None:
    """One accepted step of each active problem, to new images, gradients and values."""
    rings = history.steps, history.changes, history.products, history.used, history.newest, history.taken
    direction = np.empty((active.size, x.shape[1]), np.float32)
    kernels.towards_first_guess(active, x, gradient, lower, history.shares, *rings, direction)
    if guess is not None:
        direction = guess.smoothed(direction.reshape(-1, history.n, history.n), active).reshape(direction.shape)
    kernels.directions(active, x, gradient, lower, history.shares, history.scales, *rings, direction)
    lengths = np.ones(active.size)
    trying = np.arange(active.size)
    while trying.size:
        which = active[trying]
        trial = np.empty((trying.size, x.shape[1]), np.float32)
        promised = kernels.move(which, trying, x, direction, gradient, lengths[trying], lower, trial)
        value, slope = _evaluate(objective, trial, which, history.n)
        enough = values[which] + ARMIJO * promised + ROUNDING * np.abs(values[which])
        lengths[trying] *= SHRINK
        short = (value > enough) & (lengths[trying] > SHORTEST)
        taken = np.flatnonzero(~short)
        kernels.accept(
            which[taken], taken, trial, slope, x, gradient, history.newest, history.steps, history.changes,
            history.products, history.used,
        )  # fmt: skip
        values[which[taken]] = value[taken]
        trying = trying[short]
