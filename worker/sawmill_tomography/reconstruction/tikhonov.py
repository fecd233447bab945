"""Tikhonov regularisation: min ||A x - y||^2 + weight ||x||^2, for every weight from one bidiagonalisation of A.

The weight is `alpha` in requests and answers.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.iterative.cross_validation import parabola_minimum, power_along_detector
from sawmill_tomography.reconstruction.iterative.descent import Floats, OnIteration
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, Phases, part_of
from sawmill_tomography.reconstruction.method import FittedMethod
from sawmill_tomography.reconstruction.object_extent import check_shown
from sawmill_tomography.sinograms.noise import data_misfit, noise_of_each_ray, remarks_on, rms_noise
from sawmill_vocabulary import AlphaRule

ITERATIONS = 200
TOLERANCE = 1e-4
# Steps after which most logs have converged, by the rules that consider the noise (benchmarks/paper/methods.py).
USUAL_STEPS = 25
# Steps before the rules first consider the projected problem, and between the further times.
FIRST_CHECK, CHECK_EVERY = 12, 6
# A chosen weight that changes by more than this share between two checks has not settled.
SETTLED = 0.02
# Candidates for the weight, as shares of the largest eigenvalue of A^T A.
SHARES = np.geomspace(1e-8, 10.0, 181)
CURVE_POINTS = 60
# Every fifth view is left out, from the third on. The candidates for the weight are shares of the largest eigenvalue
# without these views; after this number of steps the images at the best weights have converged. The power that the
# images miss in these views is weighted by its frequency to this exponent, the power of the edges: on the published and
# on a simulated log, 45 to 360 views, the error is within 1 % of the best weight's; the exponents 1, 0.5 and 0 choose
# too small a weight.
VALIDATION_FIRST, VALIDATION_EVERY = 2, 5
VALIDATION_SHARES = np.geomspace(1e-6, 1.0, 25)
VALIDATION_STEPS = 40
VALIDATION_EXPONENT = 1.5
# Random signs that estimate the trace in GCV; one draw over thousands of rays is right to a per cent
# (tests/tomography/test_tikhonov.py).
PROBE_STEPS = 40
PROBE_SEED = 22
# Usual number of a basis's images that are in memory for one slice.
IMAGES_OF_A_BASIS = 100


@dataclass(frozen=True, eq=False)
class WeightCurve:
    """Curves for the rules, each (points,): weights, ||A x - y||, ||x||, and the function of GCV if it is used."""

    weights: Floats
    residual_norms: Floats
    solution_norms: Floats
    gcv: Floats | None

    def columns(self) -> dict[str, Floats]:
        """Return the curves by their names in a volume's file."""
        columns = {"alphas": self.weights, "residual_norms": self.residual_norms, "solution_norms": self.solution_norms}
        return columns if self.gcv is None else {**columns, "gcv": self.gcv}


def tikhonov(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    weight: float | None = None,
    rule: AlphaRule = AlphaRule.CROSS_VALIDATION,
    noise: ArrayLike | None = None,
    tolerance: float = TOLERANCE,
    iterations: int = ITERATIONS,
    on_progress: OnProgress | None = None,
) -> Estimate:
    """Reconstruct one slice or a block of slices (docs/understand/reconstruction.md#alpha-of-tikhonov).

    Golub-Kahan bidiagonalisation, the iteration inside LSQR (Paige and Saunders 1982), does not depend on the weight:
    it leaves a small problem, which is solved for each weight (Hansen 1998, section 6.3). The estimate's parameter
    is `alpha`, the weight, (slices,); its curves are the columns of `WeightCurve`.

    Parameters
    ----------
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air is at 0.
    weight : float, optional
        Weight in mm^2; chosen by `rule` for each slice where not given.
    noise : float, optional
        Standard deviation of the data, for the discrepancy principle and the misfit; by default the air's.
    tolerance
        Converged when ||A^T (A x - y) + weight x|| is below this share of ||A^T y||.
    on_progress : callable, optional
        Called with the finished share of the work, after every few steps.

    Raises
    ------
    GeometryError
        If shapes do not fit, a value is not positive, a slice is 0 in every ray, or cross-validation has one view.
    """
    if weight is not None and not (math.isfinite(weight) and weight > 0.0):
        raise GeometryError(f"alpha must be a positive number of mm^2, not {weight}")
    lines = projector.block(sinogram)
    check_shown(lines)
    noises = noise_of_each_ray(noise, lines)
    solved: list[_Solved] = []
    for line, level in zip(lines, np.broadcast_to(noises.ravel(), (len(lines),)), strict=True):
        on_slice = part_of(on_progress, len(solved) / len(lines), 1.0 / len(lines))
        solved.append(_solve(projector, line, _Request(weight, rule, float(level), tolerance, iterations), on_slice))
    images = np.stack([one.image for one in solved])
    misfit = data_misfit(projector, images, lines, noises)
    late = sum(not one.converged for one in solved)
    remarks = (
        (f"{late} of {len(solved)} slices had not converged after {iterations} iterations: allow more",) if late else ()
    )
    return Estimate(
        image=images if np.ndim(sinogram) == 3 else images[0],
        iterations=np.array([one.iterations for one in solved]),
        converged=np.array([one.converged for one in solved]),
        parameters={"alpha": np.array([one.weight for one in solved])},
        noise=rms_noise(noises),
        misfit=misfit,
        curves=tuple(one.curve.columns() for one in solved),
        remarks=remarks + remarks_on(projector, images, misfit, lines, noises),
    )


@dataclass(frozen=True)
class _Request:
    weight: float | None
    rule: AlphaRule
    noise: float
    tolerance: float
    iterations: int


@dataclass(frozen=True, eq=False)
class _Solved:
    image: Image
    weight: float
    curve: WeightCurve
    iterations: int
    converged: bool


def _solve(projector: Projector, line: Image, request: _Request, on_progress: OnProgress) -> _Solved:
    """Solve one slice: bidiagonalise until the solution at the current weight has converged."""
    rays = int(projector.crossing.sum())
    small = _Bidiagonalisation(projector, line, request.iterations)
    validating = request.weight is None and request.rule is AlphaRule.CROSS_VALIDATION
    probing = request.weight is None and request.rule in {AlphaRule.DISCREPANCY, AlphaRule.GCV}
    phases = Phases(on_progress, validate=VALIDATION_STEPS * validating, probe=PROBE_STEPS * probing, solve=USUAL_STEPS)
    if validating:
        request = replace(request, weight=_by_cross_validation(projector, line, phases.of("validate")))
    probe = _probe(projector, phases.of("probe")) if probing else None
    on_step = phases.descent("solve", USUAL_STEPS)
    weight = math.inf
    while True:
        small.extend(min(FIRST_CHECK if small.size == 0 else CHECK_EVERY, request.iterations - small.size), on_step)
        problem = _Projected.of(small)
        before, weight = weight, request.weight or _choose(problem, request, rays, probe)
        coefficients = problem.solution(weight)
        settled = request.weight is not None or abs(weight - before) <= SETTLED * weight
        converged = settled and small.next_norm * abs(coefficients[-1]) <= request.tolerance * small.first_gradient
        if converged or small.size >= request.iterations or small.exhausted:
            break
    curve = problem.curve(weight * np.geomspace(1e-3, 1e3, CURVE_POINTS), rays, probe)
    on_progress(1.0)
    return _Solved(small.combine(coefficients), weight, curve, small.size, converged or small.exhausted)


def _choose(problem: "_Projected", request: _Request, rays: int, probe: "_Projected | None") -> float:
    curve = problem.curve(problem.singular[0] ** 2 * SHARES, rays, probe)
    if curve.gcv is not None:
        by_gcv = float(curve.weights[np.argmin(curve.gcv)])
        if request.rule is AlphaRule.GCV:
            return by_gcv
        # The residual grows with the weight, and reaches the noise at this one or beyond an end of the range.
        level = request.noise * math.sqrt(rays)
        by_discrepancy = float(np.exp(np.interp(level, curve.residual_norms, np.log(curve.weights))))
        # A wrong geometry is not noise: a weight small enough to explain it would ruin the image and hide it.
        return max(by_discrepancy, by_gcv)
    return _by_l_curve(curve, float(problem.singular[-1] ** 2))


def _by_cross_validation(projector: Projector, line: Image, on_progress: OnProgress) -> float:
    """Choose the weight whose image from the training views predicts the validation views best."""
    geometry = projector.geometry
    views = geometry.angles_rad.size
    if views == 1:
        raise GeometryError("cross-validation leaves views out, and there is one only: give alpha or alpha_rule")
    left_out = np.zeros(views, bool)
    left_out[min(VALIDATION_FIRST, views - 1) :: VALIDATION_EVERY] = True
    training, validation = (Projector(geometry.at(part), projector.grid) for part in (~left_out, left_out))
    small = _bidiagonalised(training, line[~left_out], VALIDATION_STEPS, on_progress)
    problem = _Projected.of(small)
    weights = problem.singular[0] ** 2 * VALIDATION_SHARES
    images = np.stack([small.combine(problem.solution(weight)) for weight in weights])
    missed = np.where(validation.crossing, validation.forward(images) - line[left_out], 0.0)
    return parabola_minimum(weights, power_along_detector(missed, VALIDATION_EXPONENT))[0]


def _probe(projector: Projector, on_progress: OnProgress) -> "_Projected":
    """Bidiagonalise from random signs, which estimates the trace of A's filtered inverse."""
    signs = np.random.default_rng(PROBE_SEED).choice([-1.0, 1.0], projector.crossing.shape).astype(np.float32)
    return _Projected.of(_bidiagonalised(projector, signs, PROBE_STEPS, on_progress))


class _Bidiagonalisation:
    """Bidiagonalisation A V = U B, B lower bidiagonal, V fully orthogonal; from a line's rays that cross the field."""

    def __init__(self, projector: Projector, line: Image, most: int) -> None:
        self.projector = projector
        line = np.where(projector.crossing, line, np.float32(0.0))
        self.data_norm = float(np.linalg.norm(line))
        self._u = (line / max(self.data_norm, 1e-300)).astype(np.float32)
        # Memory that is not written to costs nothing.
        self._basis = np.empty((most, projector.grid.size**2), np.float32)
        self.diagonal: list[float] = []
        self.below: list[float] = []
        # The next two entries of B, multiplied: times the last coefficient, the norm of the normal equations' residual.
        self.next_norm = 0.0
        self._next = projector.adjoint(self._u)
        self.first_gradient = self.data_norm * float(np.linalg.norm(self._next))

    @property
    def size(self) -> int:
        return len(self.diagonal)

    @property
    def exhausted(self) -> bool:
        """True if the data show no further direction."""
        return float(np.linalg.norm(self._next)) <= 1e-6 * (self.diagonal[0] if self.diagonal else 1e-300)

    def extend(self, steps: int, on_step: OnIteration) -> None:
        """Take further steps, or fewer if the directions are exhausted; call `on_step` with each step and the limit."""
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
            on_step(self.size, len(self._basis))

    def combine(self, coefficients: Floats) -> Image:
        """Return V times the coefficients."""
        n = self.projector.grid.size
        return (coefficients.astype(np.float32) @ self._basis[: self.size]).reshape(n, n)


def _bidiagonalised(projector: Projector, line: Image, steps: int, on_progress: OnProgress) -> _Bidiagonalisation:
    """Bidiagonalise by this number of steps, or fewer if the directions are exhausted."""
    small = _Bidiagonalisation(projector, line, steps)
    small.extend(steps, lambda done, most: on_progress(done / most))
    on_progress(1.0)
    return small


@dataclass(frozen=True, eq=False)
class _Projected:
    """Projected problem min ||B z - ||y|| e1||^2 + weight ||z||^2 in the singular vectors of B."""

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

    def solution(self, weight: float) -> Floats:
        s = self.singular
        return np.asarray(self.right @ (s / (s**2 + weight) * self.seen))

    def trace(self, weights: Floats) -> Floats:
        """Compute y^T A (A^T A + weight)^-1 A^T y by Gauss quadrature; for random signs y, an estimate of the trace."""
        s = self.singular
        return np.asarray(((s * self.seen) ** 2 / (s**2 + weights[:, None])).sum(axis=1))

    def curve(self, weights: Floats, rays: int, probe: "_Projected | None") -> WeightCurve:
        s, damped = self.singular, self.singular**2 + weights[:, None]
        residual = np.sqrt(((weights[:, None] / damped * self.seen) ** 2).sum(axis=1) + self.unseen)
        gcv = None if probe is None else (residual / (rays - probe.trace(weights))) ** 2
        return WeightCurve(weights, residual, np.sqrt(((s / damped * self.seen) ** 2).sum(axis=1)), gcv)


def _by_l_curve(curve: WeightCurve, least: float) -> float:
    """Return the point of largest curvature of log ||x|| over log ||A x - y||, among the weights that are resolved."""
    step = np.log(curve.weights[1] / curve.weights[0])
    x, y = np.log(curve.residual_norms), np.log(curve.solution_norms)
    dx, dy = np.gradient(x, step), np.gradient(y, step)
    bend = (dx * np.gradient(dy, step) - np.gradient(dx, step) * dy) / np.maximum(dx**2 + dy**2, 1e-12) ** 1.5
    return float(curve.weights[np.argmax(np.where(curve.weights > least, bend, -np.inf))])


@dataclass(frozen=True)
class Tikhonov(FittedMethod):
    """The method `tikhonov` in the table of methods."""

    least_images: ClassVar[int] = IMAGES_OF_A_BASIS
    # Slices are solved one by one, which makes a projection 2.4 times as slow (benchmarks/iterative.py at 3ab7f653).
    pairs_a_slice: ClassVar[float] = 2.4 * (USUAL_STEPS + VALIDATION_STEPS)
    shrinks: ClassVar[bool] = True

    alpha: float | None = None
    alpha_rule: AlphaRule = AlphaRule.CROSS_VALIDATION

    def reconstruct(
        self, projector: Projector, lines: Image, *, noise: FloatArray, on_progress: OnProgress
    ) -> Estimate:
        """Reconstruct a block; each slice chooses its own weight."""
        return tikhonov(projector, lines, weight=self.alpha, rule=self.alpha_rule, noise=noise, on_progress=on_progress)
