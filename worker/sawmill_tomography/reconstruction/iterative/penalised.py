"""Weighted least squares with an edge-preserving prior, and its descent by continuation in the prior's scale."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numba import get_num_threads

from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.iterative import _descent_numba as kernels
from sawmill_tomography.reconstruction.iterative import _haar_numba as haar
from sawmill_tomography.reconstruction.iterative.descent import (
    WINDOW,
    Floats,
    Images,
    Indices,
    Minimum,
    OnIteration,
    Preconditioner,
    minimise,
)
from sawmill_tomography.reconstruction.iterative.priors import Prior

# The Cauchy density is not log-concave: a first descent with this multiple of its scale leads to lower minima. Both
# numbers were found on simulated logs (benchmarks/choosing.py, benchmarks/iterative.py at 3ab7f653).
CONTINUATION_FACTOR = 8.0
CONTINUATION_ITERATIONS = 15
# Seed of the random image that shows the data's curvature: equal data give equal answers.
SEED = 22


@dataclass(frozen=True, eq=False)
class Objective:
    """Objective 1/2 sum weights (A x - y)^2 + prior, for several images in parallel."""

    projector: Projector
    lines: Images  # (images, views, detector) float32: the weights are 1 / sigma^2
    weights: Images  # (images, views, detector) float32
    prior: Prior

    def only(self, index: int) -> "Objective":
        """Return the objective of one image."""
        which = np.array([index])
        return replace(
            self, lines=_of(self.lines, which), weights=_of(self.weights, which), prior=self.prior.only(index)
        )

    def __call__(self, images: Images, which: Indices) -> tuple[Floats, Images]:
        """Return values (named,) and gradients (named, n, n)."""
        weighted = self.projector.forward(images)
        values = kernels.weigh(weighted, self.lines, self.weights, which)
        gradient = self.projector.adjoint(weighted)
        return values + self.prior.add(images, which, gradient), gradient


class InverseCurvature:
    """Preconditioner: the inverse curvature of a flat image, scaled at each pixel by the prior's own curvature there.

    For a flat image of stiffness k the curvature at the frequency w is c / |w| + k |w|^2: the data's part, as their
    adjoint projection blurs by 1 / |w| (Natterer 2001, section 2.1), and the prior's part. c follows from the mean
    diagonal of A^T W A, estimated with an image of random signs.
    """

    def __init__(self, objective: Objective) -> None:
        self._prior = objective.prior
        n = objective.projector.grid.size
        signs = np.random.default_rng(SEED).choice(np.array([-1.0, 1.0], np.float32), (n, n))
        seen = np.square(objective.projector.forward(signs))
        total = np.einsum("skm,km->s", objective.weights, seen, dtype=np.float64) / n**2
        self._stiffness = objective.prior.even_share * objective.prior.stiffest()
        self._data = np.broadcast_to(total, self._stiffness.shape)
        self._inverse = self._inverse_of(*_flat_curvatures(n))

    def _inverse_of(self, blur: Floats, rough: Floats) -> Images:
        """Return the inverse curvature at the frequencies of a real transform."""
        half = blur.shape[1] // 2 + 1
        curvature = np.multiply.outer(self._data, blur[:, :half]) + np.multiply.outer(self._stiffness, rough[:, :half])
        return np.asarray(1.0 / curvature, np.float32)

    def flat(self) -> Floats:
        """Return the diagonal of the curvature of a flat image, (images,)."""
        return np.asarray(self._data + 4.0 * self._prior.stiffest())

    def scaling(self, images: Images, which: Indices) -> Images:
        """Return the square root of each pixel's softness relative to a flat image, (named, n, n)."""
        return self._prior.scaling(images, which, self._data)

    def smoothed(self, images: Images, which: Indices) -> Images:
        """Apply the inverse curvature of a flat image to images (named, n, n)."""
        threads, shape = get_num_threads(), images.shape[1:]
        spectrum = scipy.fft.rfft2(images, workers=threads)
        spectrum *= self._inverse[which]
        return np.asarray(scipy.fft.irfft2(spectrum, s=shape, workers=threads, overwrite_x=True))


class HalvedInverseCurvature(InverseCurvature):
    """Preconditioner like `InverseCurvature` for images of even size, in a third of the time.

    One step of the orthonormal Haar transform splits the image into means of four pixels and their differences. Each
    difference has one curvature, its mean over the frequencies, and only the means are transformed (Mallat 2009,
    section 7.7).
    """

    def _inverse_of(self, blur: Floats, rough: Floats) -> Images:
        angle = np.pi * scipy.fft.fftfreq(len(blur))
        mean, difference = np.cos(angle) ** 2, np.sin(angle) ** 2

        def of_differences(share: Floats) -> Floats:
            shares = 4.0 * share
            return np.asarray(1.0 / (self._data * (shares * blur).mean() + self._stiffness * (shares * rough).mean()))

        self._straight = of_differences(np.multiply.outer(mean, difference))
        self._diagonal = of_differences(np.multiply.outer(difference, difference))
        size = len(blur) // 2

        def of_means(curvature: Floats) -> Floats:
            # A frequency of the means represents four frequencies of the pixels.
            return np.asarray((np.multiply.outer(mean, mean) * curvature).reshape(2, size, 2, size).sum(axis=(0, 2)))

        return super()._inverse_of(of_means(blur), of_means(rough))

    def smoothed(self, images: Images, which: Indices) -> Images:
        """Apply the inverse curvature of a flat image to images (named, n, n)."""
        size = images.shape[1] // 2
        means, out = np.empty((len(images), size, size), np.float32), np.empty_like(images)
        haar.means(images, means)
        haar.join(images, super().smoothed(means, which), self._straight[which], self._diagonal[which], out)
        return out


def _flat_curvatures(n: int) -> tuple[Floats, Floats]:
    """Return the curvature of data and of a prior over a flat image, at the frequencies of (n, n); in own units."""
    angle = 2.0 * np.pi * scipy.fft.fftfreq(n)
    frequency = np.hypot(angle[:, None], angle)
    frequency[0, 0] = np.pi / n
    blur = 1.0 / frequency
    return blur / blur.mean(), 4.0 * (np.sin(0.5 * angle)[:, None] ** 2 + np.sin(0.5 * angle) ** 2)


def weights_of(sigmas: Floats, shape: tuple[int, ...]) -> Images:
    """Return the weights 1 / sigma^2 of rays of a shape; 0 for a ray that is left out, whose sigma is infinite.

    They lie in memory as images do: kernels are compiled for that alone.
    """
    return np.ascontiguousarray(np.broadcast_to(1.0 / sigmas**2, shape), np.float32)


def _of(rays: Images, which: Indices) -> Images:
    return rays if len(rays) == 1 else rays[which]


def descend(
    objective: Objective,
    start: Images,
    *,
    non_negative: bool,
    iterations: int,
    tolerance: float,
    window: int = WINDOW,
    preconditioner: Callable[[Objective], Preconditioner] | None = InverseCurvature,
    first_scale: float = 1.0,
    on_iteration: OnIteration | None = None,
) -> Minimum:
    """Minimise from the image of `continuation`, or from another one; with or without a preconditioner."""
    return minimise(
        objective,
        start,
        lower=0.0 if non_negative else -np.inf,
        iterations=iterations,
        tolerance=tolerance,
        window=window,
        preconditioner=None if preconditioner is None else preconditioner(objective),
        first_scale=first_scale,
        on_iteration=on_iteration,
    )


def continuation(
    objective: Objective,
    start: Images,
    *,
    non_negative: bool,
    tolerance: float,
    on_iteration: OnIteration | None = None,
) -> Images:
    """Run some iterations with a multiple of the prior's scale, which smooths edges; return images (images, n, n)."""
    return descend(
        replace(objective, prior=objective.prior.rescaled(CONTINUATION_FACTOR)),
        start,
        non_negative=non_negative,
        iterations=CONTINUATION_ITERATIONS,
        tolerance=tolerance,
        preconditioner=None,
        on_iteration=on_iteration,
    ).images
