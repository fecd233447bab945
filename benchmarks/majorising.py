"""Majorise-minimise rivals of the quasi-Newton descent: both lower the quadratic that touches the objective from above.

At an image the prior is majorised by the quadratic whose curvature over a difference d is a reweighted one's,
stiffest / (1 + |d|^2 / scale^2) (half-quadratic, Geman and Reynolds 1992). Both rivals have the preconditioner
of the quasi-Newton descent, keep pixels at the bound as it does, and bend and shorten their
steps as it does; they differ in how the step is found.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.iterative.descent import (
    ARMIJO,
    ROUNDING,
    SHORTEST,
    SHRINK,
    Floats,
    Images,
    Indices,
)
from sawmill_tomography.reconstruction.iterative.penalised import InverseCurvature, Objective

ONE = np.zeros(1, np.int64)
# The conjugate gradients end when their preconditioned residual has fallen to this share.
INNER_TOLERANCE = 0.1


@dataclass(frozen=True)
class Counted(Projector):
    """A projector that counts how often it was used, forward and back."""

    used: list[int] = field(default_factory=lambda: [0])

    def forward(self, image: Images) -> Images:
        """Project an image as the product does, and count it."""
        self.used[0] += 1
        return super().forward(image)

    def adjoint(self, sinogram: Images) -> Images:
        """Back-project a sinogram as the product does, and count it."""
        self.used[0] += 1
        return super().adjoint(sinogram)


@dataclass
class Tracked:
    """An objective of one image on a counted projector, each value written down with its time and projections."""

    objective: Objective
    started: float = field(default_factory=time.perf_counter)
    track: list[tuple[float, int, float]] = field(default_factory=list)

    def __call__(self, images: Images, which: Indices) -> tuple[Floats, Images]:
        """Return value and gradient like the objective."""
        value, gradient, _ = self.with_residual(images, which)
        return value, gradient

    def with_residual(self, images: Images, which: Indices = ONE) -> tuple[Floats, Images, Images]:
        """Return value, gradient, and A x - y."""
        objective = self.objective
        residual = objective.projector.forward(images) - objective.lines
        weighted = residual * objective.weights
        gradient = objective.projector.adjoint(weighted)
        value = 0.5 * np.einsum("skm,skm->s", residual, weighted, dtype=np.float64)
        value += objective.prior.add(images, which, gradient)
        self.track.append((time.perf_counter() - self.started, objective.projector.used[0], float(value[0])))
        return value, gradient, residual


class _Majorant:
    """The quadratic's matrix at an image, A^T W A + G^T C G, the corner's term left out."""

    def __init__(self, objective: Objective, image: Images) -> None:
        self.objective = objective
        dx, dy = _differences(image)
        prior = objective.prior
        self.curvature = (prior.stiffest() / (1.0 + (dx**2 + dy**2) / prior.scale**2)).astype(np.float32)

    def product(self, one: Images, other: Images, lines: Images, other_lines: Images) -> float:
        """Compute one . H other from both images and their projections."""
        data = np.vdot(lines * self.objective.weights, other_lines)
        dx, dy = _differences(one)
        ex, ey = _differences(other)
        return float(data + np.vdot(self.curvature, dx * ex + dy * ey))

    def __call__(self, image: Images) -> Images:
        objective = self.objective
        out = objective.projector.adjoint(objective.projector.forward(image) * objective.weights)
        dx, dy = (self.curvature * d for d in _differences(image))
        out[:, 1:, :-1] += dx
        out[:, :-1, 1:] += dy
        out[:, :-1, :-1] -= dx + dy
        return out


def reweighted(objective: Objective, start: Images, *, iterations: int, inner: int) -> Tracked:
    """Minimise by iteratively reweighted least squares, each solved in `inner` preconditioned CG steps at most."""
    call, preconditioner = Tracked(objective), InverseCurvature(objective)
    call.started = time.perf_counter()

    def step(x: Images, gradient: Images, residual: Images, free: Images) -> Images:  # noqa: ARG001
        majorant, shares = _Majorant(objective, x), preconditioner.scaling(x, ONE) * free
        found, r = np.zeros_like(x), -gradient * free
        z = shares * preconditioner.smoothed(shares * r, ONE)
        p, rz = z, float(np.vdot(r, z))
        limit = INNER_TOLERANCE**2 * rz
        for _ in range(inner):
            if rz <= limit:
                break
            hp = majorant(p) * free
            length = np.float32(rz / np.vdot(p, hp))
            found += length * p
            r -= length * hp
            z = shares * preconditioner.smoothed(shares * r, ONE)
            following = float(np.vdot(r, z))
            p, rz = z + np.float32(following / rz) * p, following
        return found

    _descend(call, start, iterations, step)
    return call


def memory_gradient(objective: Objective, start: Images, *, iterations: int, memory: int) -> Tracked:
    """Minimise the majorant on the plane of the preconditioned gradient and the last steps.

    Chouzenoux, Idier and Moussaoui 2011, with a preconditioner; `memory` steps are remembered.
    """
    call, preconditioner = Tracked(objective), InverseCurvature(objective)
    call.started = time.perf_counter()
    steps: list[tuple[Images, Images]] = []
    before: list[tuple[Images, Images]] = []

    def step(x: Images, gradient: Images, residual: Images, free: Images) -> Images:
        if before:
            last_x, last_residual = before.pop()
            steps.append((x - last_x, residual - last_residual))
            del steps[:-memory]
        before.append((x, residual))
        majorant, shares = _Majorant(objective, x), preconditioner.scaling(x, ONE) * free
        steepest = -shares * preconditioner.smoothed(shares * gradient, ONE)
        plane = [(steepest, objective.projector.forward(steepest)), *steps]
        matrix = np.array([[majorant.product(a, b, la, lb) for b, lb in plane] for a, la in plane])
        slopes = np.array([float(np.vdot(gradient, a)) for a, _ in plane])
        shares_of = np.linalg.lstsq(matrix, -slopes, rcond=1e-10)[0].astype(np.float32)
        return sum((share * a for share, (a, _) in zip(shares_of, plane, strict=True)), np.zeros_like(x)) * free

    _descend(call, start, iterations, step)
    return call


def _descend(
    call: Tracked, start: Images, iterations: int, step: Callable[[Images, Images, Images, Images], Images]
) -> None:
    """Take steps bent along the bound 0 and shortened until they gain enough; free pixels are 1, at the bound 0."""
    x = start
    value, gradient, residual = call.with_residual(x)
    for _ in range(iterations):
        free = ((x > 0.0) | (gradient <= 0.0)).astype(np.float32)
        direction = step(x, gradient, residual, free)
        length = 1.0
        while True:
            trial = np.maximum(x + np.float32(length) * direction, np.float32(0.0))
            found = call.with_residual(trial)
            enough = value + ARMIJO * np.vdot(gradient, trial - x) + ROUNDING * np.abs(value)
            if found[0] <= enough or length <= SHORTEST:
                break
            length *= SHRINK
        x, (value, gradient, residual) = trial, found


def _differences(image: Images) -> tuple[Images, Images]:
    here = image[:, :-1, :-1]
    return image[:, 1:, :-1] - here, image[:, :-1, 1:] - here
