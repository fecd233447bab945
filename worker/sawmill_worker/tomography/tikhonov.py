"""Tikhonov regularisation: min ||A x - y||^2 + alpha ||x||^2, every alpha from one bidiagonalisation of A."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_worker.tomography.geometry import GeometryError
from sawmill_worker.tomography.iterative.descent import Floats, Indices
from sawmill_worker.tomography.iterative.telling import Phases, Told, part_of
from sawmill_worker.tomography.noise import data_misfit, noise_of_each_ray, remarks_on
from sawmill_worker.tomography.object_extent import check_shown
from sawmill_worker.tomography.projector import Image, Projector
from sawmill_worker.vocabulary import AlphaRule

ITERATIONS = 200
TOLERANCE = 1e-4
# Steps after which most logs have converged, by the rules that look at the noise.
USUAL_STEPS = 25
# The rules look at the projected problem first after so many steps, and then after every so many.
FIRST_LOOK, LOOK_EVERY = 12, 6
# A chosen alpha that moves by more than this share between two looks is not settled.
SETTLED = 0.02
# Alphas tried, as shares of the largest eigenvalue of A^T A.
SHARES = np.geomspace(1e-8, 10.0, 181)
CURVE_POINTS = 60
# Random signs that estimate the trace in GCV; one draw over thousands of rays is right to a per cent.
PROBE_STEPS = 40
PROBE_SEED = 22


@dataclass(frozen=True, eq=False)
class AlphaCurve:
    """What the rules saw of one slice: alphas, ||A x - y||, ||x||, and with GCV its function, each (points,)."""

    alphas: Floats
    residual_norms: Floats
    solution_norms: Floats
    gcv: Floats | None


@dataclass(frozen=True, eq=False)
class Tikhonov:
    """The reconstruction and what led to it.

    Attributes
    ----------
    image : (size, size) or (slices, size, size) float32
        [x, y], in the sinogram's unit per mm.
    alpha : (slices,) float64
    curves : tuple of AlphaCurve
        One a slice, for the picture.
    iterations, converged : (slices,)
        Steps of the bidiagonalisation; whether ||A^T (A x - y) + alpha x|| fell below tolerance * ||A^T y||.
    noise : float
        Root mean square of the data's noise, given or estimated.
    misfit : (slices,) float64
        Root mean square of (A x - y) / noise.
    remarks : tuple of str
    """

    image: Image
    alpha: Floats
    curves: tuple[AlphaCurve, ...]
    iterations: Indices
    converged: NDArray[np.bool_]
    noise: float
    misfit: Floats
    remarks: tuple[str, ...]


def tikhonov(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    alpha: float | None = None,
    rule: AlphaRule = AlphaRule.DISCREPANCY,
    noise: float | None = None,
    tolerance: float = TOLERANCE,
    iterations: int = ITERATIONS,
    progress: Told | None = None,
) -> Tikhonov:
    """Reconstruct one slice or a block of slices (design page, section 4).

    Golub-Kahan bidiagonalisation, the iteration inside LSQR (Paige and Saunders 1982), does not depend on alpha: each
    alpha is solved for in the small problem that it leaves (Hansen 1998, section 6.3).

    Parameters
    ----------
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air stands at 0.
    alpha : float, optional
        In mm^2; chosen by `rule` for each slice where not given.
    noise : float, optional
        Standard deviation of the data, for the discrepancy principle and the misfit; by default that of the air.
    tolerance
        Converged when ||A^T (A x - y) + alpha x|| is below this share of ||A^T y||.
    progress : callable, optional
        Told the share of all the work that is done, after every few steps.

    Raises
    ------
    GeometryError
        If shapes do not fit, a value is not positive, or a slice is 0 in every ray.
    """
    if alpha is not None and not (math.isfinite(alpha) and alpha > 0.0):
        raise GeometryError(f"alpha must be a positive number of mm^2, not {alpha}")
    lines = projector.block(sinogram)
    check_shown(lines)
    noises = noise_of_each_ray(noise, lines)
    of_each = np.broadcast_to(noises.ravel(), (len(lines),))
    solved: list[_Solved] = []
    for line, level in zip(lines, of_each, strict=True):
        tell = part_of(progress, len(solved) / len(lines), 1.0 / len(lines))
        wanted = _Wanted(alpha, rule, float(level), tolerance, iterations)
        solved.append(_solve(projector, line, wanted, tell))
    images = np.stack([one.image for one in solved])
    misfit = data_misfit(projector, images, lines, noises)
    late = sum(not one.converged for one in solved)
    remarks = (
        (f"{late} of {len(solved)} slices had not converged after {iterations} iterations: allow more",) if late else ()
    )
    return Tikhonov(
        image=images if np.ndim(sinogram) == 3 else images[0],
        alpha=np.array([one.alpha for one in solved]),
        curves=tuple(one.curve for one in solved),
        iterations=np.array([one.iterations for one in solved]),
        converged=np.array([one.converged for one in solved]),
        noise=float(np.sqrt(np.mean(noises**2))),
        misfit=misfit,
        remarks=remarks + remarks_on(misfit, lines, noises),
    )


@dataclass(frozen=True)
class _Wanted:
    alpha: float | None
    rule: AlphaRule
    noise: float
    tolerance: float
    iterations: int


@dataclass(frozen=True, eq=False)
class _Solved:
    image: Image
    alpha: float
    curve: AlphaCurve
    iterations: int
    converged: bool


def _solve(projector: Projector, line: Image, wanted: _Wanted, tell: Told) -> _Solved:
    """One slice: bidiagonalise until the solution at the alpha of the moment has converged."""
    rays = int(projector.crossing.sum())
    small = _Bidiagonalisation(projector, np.where(projector.crossing, line, np.float32(0.0)), wanted.iterations)
    probing = wanted.alpha is None and wanted.rule is not AlphaRule.L_CURVE
    phases = Phases(tell, probe=PROBE_STEPS * probing, solve=USUAL_STEPS)
    probe = _probe(projector, phases.of("probe")) if probing else None
    solving = phases.descent("solve", USUAL_STEPS)
    alpha = math.inf
    while True:
        small.extend(min(FIRST_LOOK if small.size == 0 else LOOK_EVERY, wanted.iterations - small.size))
        problem = _Projected.of(small)
        before, alpha = alpha, wanted.alpha or _choose(problem, wanted, rays, probe)
        weights = problem.solution(alpha)
        settled = wanted.alpha is not None or abs(alpha - before) <= SETTLED * alpha
        converged = settled and small.next_norm * abs(weights[-1]) <= wanted.tolerance * small.first_gradient
        solving(small.size, wanted.iterations)
        if converged or small.size >= wanted.iterations or small.exhausted:
            break
    curve = problem.curve(alpha * np.geomspace(1e-3, 1e3, CURVE_POINTS), rays, probe)
    tell(1.0)
    return _Solved(small.combine(weights), alpha, curve, small.size, converged or small.exhausted)


def _choose(problem: "_Projected", wanted: _Wanted, rays: int, probe: "_Projected | None") -> float:
    curve = problem.curve(problem.singular[0] ** 2 * SHARES, rays, probe)
    if curve.gcv is not None:
        foretelling = float(curve.alphas[np.argmin(curve.gcv)])
        if wanted.rule is AlphaRule.GCV:
            return foretelling
        # A wrong geometry is no noise: an alpha small enough to explain it would ruin the image and hide it.
        return max(_by_discrepancy(curve, wanted.noise * math.sqrt(rays)), foretelling)
    return _by_l_curve(curve, float(problem.singular[-1] ** 2))


def _probe(projector: Projector, tell: Told) -> "_Projected":
    """The same bidiagonalisation started from random signs: it knows the trace of A's filtered inverse."""
    signs = np.random.default_rng(PROBE_SEED).choice([-1.0, 1.0], projector.crossing.shape)
    small = _Bidiagonalisation(projector, np.where(projector.crossing, signs, 0.0).astype(np.float32), PROBE_STEPS)
    for step in range(PROBE_STEPS):
        small.extend(1)
        tell((step + 1) / PROBE_STEPS)
    return _Projected.of(small)


class _Bidiagonalisation:
    """A V = U B with B lower bidiagonal, V kept orthogonal in full."""

    def __init__(self, projector: Projector, line: Image, most: int) -> None:
        self.projector = projector
        self.data_norm = float(np.linalg.norm(line))
        self._u = (line / max(self.data_norm, 1e-300)).astype(np.float32)
        # Memory that is not written to costs nothing.
        self._basis = np.empty((most, projector.grid.size**2), np.float32)
        self.diagonal: list[float] = []
        self.below: list[float] = []
        # alpha_(k+1) beta_(k+1): times the last weight, the norm of the normal equations' residual.
        self.next_norm = 0.0
        self._next = projector.adjoint(self._u)
        self.first_gradient = self.data_norm * float(np.linalg.norm(self._next))

    @property
    def size(self) -> int:
        return len(self.diagonal)

    @property
    def exhausted(self) -> bool:
        """Whether no direction is left that the data could tell from the others."""
        norm = float(np.linalg.norm(self._next))
        return norm <= 1e-6 * (self.diagonal[0] if self.diagonal else 1e-300)

    def extend(self, steps: int) -> None:
        """Take so many more steps, or fewer if the directions are exhausted."""
        for _ in range(steps):
            if self.exhausted:
                return
            diagonal = float(np.linalg.norm(self._next))
            v: Image = self._next / np.float32(diagonal)
            u: Image = self.projector.forward(v) - np.float32(diagonal) * self._u
            below = float(np.linalg.norm(u))
            self._u = u / np.float32(max(below, 1e-300))
            self._basis[self.size] = v.ravel()
            self.diagonal.append(diagonal)
            self.below.append(below)
            following = self.projector.adjoint(self._u) - np.float32(below) * v
            basis = self._basis[: self.size]
            following -= ((basis @ following.ravel()) @ basis).reshape(following.shape)
            self._next = following
            self.next_norm = below * float(np.linalg.norm(following))

    def combine(self, weights: Floats) -> Image:
        """V times the weights."""
        n = self.projector.grid.size
        image: Image = (weights.astype(np.float32) @ self._basis[: self.size]).reshape(n, n)
        return image


@dataclass(frozen=True, eq=False)
class _Projected:
    """min ||B z - ||y|| e1||^2 + alpha ||z||^2 in the singular vectors of B."""

    singular: Floats
    seen: Floats
    right: Floats
    unseen: float

    @classmethod
    def of(cls, small: _Bidiagonalisation) -> "_Projected":
        k = small.size
        b = np.zeros((k + 1, k))
        b[np.arange(k), np.arange(k)] = small.diagonal
        b[np.arange(k) + 1, np.arange(k)] = small.below
        left, singular, right = np.linalg.svd(b)
        first = small.data_norm * left[0]
        return cls(singular, first[:k], right.T, float(first[k] ** 2))

    def solution(self, alpha: float) -> Floats:
        s = self.singular
        return np.asarray(self.right @ (s / (s**2 + alpha) * self.seen))

    def trace(self, alphas: Floats) -> Floats:
        """y^T A (A^T A + alpha)^-1 A^T y by Gauss quadrature; for random signs y, an estimate of the trace."""
        s = self.singular
        return np.asarray(((s * self.seen) ** 2 / (s**2 + alphas[:, None])).sum(axis=1))

    def curve(self, alphas: Floats, rays: int, probe: "_Projected | None") -> AlphaCurve:
        s, damped = self.singular, self.singular**2 + alphas[:, None]
        residual = np.sqrt(((alphas[:, None] / damped * self.seen) ** 2).sum(axis=1) + self.unseen)
        solution = np.sqrt(((s / damped * self.seen) ** 2).sum(axis=1))
        gcv = None if probe is None else (residual / (rays - probe.trace(alphas))) ** 2
        return AlphaCurve(alphas, residual, solution, gcv)


def _by_discrepancy(curve: AlphaCurve, level: float) -> float:
    """Where the residual, which grows with alpha, reaches the noise; an end of the range where it does nowhere."""
    return float(np.exp(np.interp(level, curve.residual_norms, np.log(curve.alphas))))


def _by_l_curve(curve: AlphaCurve, least: float) -> float:
    """The point of largest curvature of log ||x|| over log ||A x - y||, among the alphas that are resolved."""
    step = np.log(curve.alphas[1] / curve.alphas[0])
    x, y = np.log(curve.residual_norms), np.log(curve.solution_norms)
    dx, dy = np.gradient(x, step), np.gradient(y, step)
    bend = (dx * np.gradient(dy, step) - np.gradient(dx, step) * dy) / np.maximum(dx**2 + dy**2, 1e-12) ** 1.5
    return float(curve.alphas[np.argmax(np.where(curve.alphas > least, bend, -np.inf))])
