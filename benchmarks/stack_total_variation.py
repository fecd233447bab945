"""Isotropic total variation of a whole stack, as 3-D reconstruction software has it: a rival with the truth in hand.

The objective is 1/2 sum ((A x - y) / noise)^2 + weight * sum (sqrt(dx^2 + dy^2 + (axis dz)^2 + s^2) - s), x >= 0, all
rows at once (Rudin, Osher and Fatemi 1992; forward differences, the last one 0). The spectral projected gradient
(Birgin, Martinez and Raydan 2000) descends from the minimum of each slice alone. None of it is the product's solver.
"""

from dataclasses import dataclass

import numpy as np

from sawmill_worker.tomography.noise import noise_of_each_ray
from sawmill_worker.tomography.projector import Image, Projector

# A step must not rise above the highest of the last objectives, less this share of what the slope predicts.
MEMORY, ARMIJO, SHORTEST = 8, 1e-4, 1e-4


@dataclass(frozen=True, eq=False)
class StackObjective:
    """The objective of some rows.

    Attributes
    ----------
    lines : (rows, views, detector) float32
    weight : float
        In 1 / attenuation.
    axis : float
        Of a difference from row to row, relative to one in the plane.
    smoothing : float
        s, in the unit of attenuation.
    """

    projector: Projector
    lines: Image
    weight: float
    axis: float
    smoothing: float

    def minimum(self, start: Image, iterations: int) -> Image:
        """The stack (rows, size, size) of lowest objective on the way from another stack, after all iterations."""
        noises = np.broadcast_to(noise_of_each_ray(None, self.lines), self.lines.shape).astype(np.float32)
        images = np.maximum(start, 0.0)
        value, gradient = self.evaluate(images, noises)
        lowest, best, values, length = value, images, [value], self.smoothing / float(np.abs(gradient).max())
        for _ in range(iterations):
            way = np.maximum(images - np.float32(length) * gradient, 0.0) - images
            slope, share = float(np.vdot(gradient, way)), 1.0
            while True:
                trial = images + np.float32(share) * way
                value, next_gradient = self.evaluate(trial, noises)
                if value <= max(values[-MEMORY:]) + ARMIJO * share * slope or share < SHORTEST:
                    break
                share *= 0.5
            step, change = trial - images, next_gradient - gradient
            length = float(np.vdot(step, step)) / max(float(np.vdot(step, change)), 1e-30)
            images, gradient = trial, next_gradient
            values.append(value)
            if value < lowest:
                lowest, best = value, images
        return best

    def evaluate(self, images: Image, noises: Image) -> tuple[float, Image]:
        """Value and gradient."""
        residual = (self.projector.forward(images) - self.lines) / noises
        gradient = self.projector.adjoint(residual / noises)
        penalty = self.penalty(images, gradient)
        return 0.5 * float(np.vdot(residual, residual)) + penalty, gradient

    def penalty(self, images: Image, gradient: Image) -> float:
        """The weighted sum of differences; its gradient is added."""
        every = (slice(None), slice(None))
        # Along the rows and the two axes of the plane: the weight, and the pixels before and after each difference.
        axes = [
            (factor, (*every[:axis], slice(None, -1)), (*every[:axis], slice(1, None)))
            for axis, factor in enumerate((self.axis, 1.0, 1.0))
        ]
        steps = [np.zeros_like(images) for _ in axes]
        for (factor, before, after), step in zip(axes, steps, strict=True):
            step[before] = factor * (images[after] - images[before])
        size = np.sqrt(sum(step * step for step in steps) + np.float32(self.smoothing**2))
        for (factor, before, after), step in zip(axes, steps, strict=True):
            pull = np.float32(self.weight * factor) * (step / size)[before]
            gradient[before] -= pull
            gradient[after] += pull
        return self.weight * float(np.sum(size, dtype=np.float64) - self.smoothing * size.size)
