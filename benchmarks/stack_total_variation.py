"""Isotropic total variation of a whole stack, as 3-D reconstruction software has it: a rival with the truth in hand.

The objective is 1/2 sum ((A x - y) / noise)^2 + weight * sum (sqrt(dx^2 + dy^2 + (axis dz)^2 + s^2) - s), x >= 0, all
rows at once (Rudin, Osher and Fatemi 1992; forward differences, the last one 0). It is convex, so any way to its
minimum will do: the product's descent takes it, which spectral projected gradients came near to in 640 iterations.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.iterative.descent import Floats, Indices, minimise
from sawmill_tomography.reconstruction.iterative.penalised import InverseCurvature, Objective
from sawmill_tomography.reconstruction.total_variation_weights import SMOOTHING_SHARE, smoothed_prior
from sawmill_tomography.sinograms.noise import noise_of_each_ray

ITERATIONS, AT_REST = 300, 1e-4


@dataclass(frozen=True, eq=False)
class StackObjective:
    """The objective of some rows.

    Attributes
    ----------
    lines : (rows, views, detector) float32
    weight : float
        Weight in 1 / attenuation.
    axis : float
        Weight of a difference from row to row, relative to one in the plane.
    wood : float
        Attenuation of the wood; s is SMOOTHING_SHARE of this attenuation.
    """

    projector: Projector
    lines: Image
    weight: float
    axis: float
    wood: float

    def minimum(self, start: Image) -> Image:
        """Minimise from another stack; return the stack (rows, size, size) at rest."""
        found = minimise(
            self, start[None], lower=0.0, iterations=ITERATIONS, tolerance=AT_REST, preconditioner=_Curvature(self)
        )
        images: Image = found.images[0]
        return images

    def __call__(self, stacks: Image, _which: Indices) -> tuple[Floats, Image]:
        """Return value (1,) and gradient of one stack (1, rows, size, size)."""
        images = stacks[0]
        residual = self.projector.forward(images) - self.lines
        weighted = residual * self.certainties
        gradient = self.projector.adjoint(weighted)
        value = 0.5 * float(np.vdot(residual, weighted)) + self.penalty(images, gradient)
        return np.array([value]), gradient[None]

    @cached_property
    def certainties(self) -> Image:
        """1 / variance of each ray."""
        noises = np.broadcast_to(noise_of_each_ray(None, self.lines), self.lines.shape)
        return (1.0 / noises**2).astype(np.float32)

    def penalty(self, images: Image, gradient: Image) -> float:
        """Compute the weighted sum of differences, and add its gradient."""
        smoothing, every = SMOOTHING_SHARE * self.wood, (slice(None), slice(None))
        # Along the rows and the two axes of the plane: the weight, and the pixels before and after each difference.
        axes = [
            (factor, (*every[:axis], slice(None, -1)), (*every[:axis], slice(1, None)))
            for axis, factor in enumerate((self.axis, 1.0, 1.0))
        ]
        steps = [np.zeros_like(images) for _ in axes]
        for (factor, before, after), step in zip(axes, steps, strict=True):
            step[before] = factor * (images[after] - images[before])
        size = np.sqrt(sum(step * step for step in steps) + np.float32(smoothing**2))
        for (factor, before, after), step in zip(axes, steps, strict=True):
            pull = np.float32(self.weight * factor) * (step / size)[before]
            gradient[before] -= pull
            gradient[after] += pull
        return self.weight * float(np.sum(size, dtype=np.float64) - smoothing * size.size)


class _Curvature:
    """The preconditioner of each row by itself: the neighbouring rows are left to the descent."""

    def __init__(self, stack: StackObjective) -> None:
        prior = smoothed_prior(*(np.full(len(stack.lines), value) for value in (stack.wood, stack.weight)))
        self._rows = np.arange(len(stack.lines))
        self._own = InverseCurvature(Objective(stack.projector, stack.lines, stack.certainties, prior))

    def scaling(self, stacks: Image, _which: Indices) -> Image:
        return self._own.scaling(stacks[0], self._rows)[None]

    def smoothed(self, stacks: Image, _which: Indices) -> Image:
        return self._own.smoothed(stacks[0], self._rows)[None]
