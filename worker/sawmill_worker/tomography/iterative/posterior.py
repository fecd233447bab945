"""How uncertain each pixel of a reconstruction is: the Laplace approximation around it, by sampling."""

import numpy as np

from sawmill_worker.tomography.iterative.descent import Floats, Images
from sawmill_worker.tomography.iterative.priors import Prior
from sawmill_worker.tomography.iterative.progress import OnProgress, part_of
from sawmill_worker.tomography.projector import BLOCK, Image, Projector

# 32 samples leave 12 per cent of error on each deviation, and the conjugate gradients' tolerance adds little to it
# (tests/tomography/test_cauchy_map.py compares with the dense inverse).
SAMPLES = 32
ITERATIONS = 60
TOLERANCE = 1e-2
SEED = 21


def posterior_deviation(
    projector: Projector,
    weights: Images,
    prior: Prior,
    images: Images,
    *,
    non_negative: bool,
    samples: int = SAMPLES,
    iterations: int = ITERATIONS,
    on_progress: OnProgress | None = None,
) -> Image:
    """Standard deviation of each pixel of images (slices, n, n), in their unit.

    The density is taken as the Gaussian with the precision H = A^T W A + G^T C G, W the weights 1 / sigma^2 and C the
    curvature that the prior's reweighted quadratic has at the image. Its samples are H^-1 (A^T W^1/2 e + G^T C^1/2 e')
    with white noise e, e' (Papandreou and Yuille 2010); each pixel's spread over 32 of them is right to 12 per cent.
    Pixels at the bound 0 have none. It is the effect of noise alone, between edges that stay where they are: neither
    the error of a wrong geometry nor that of an edge elsewhere. `on_progress` is called with the share of the
    work that is done, after every few samples.
    """
    rng = np.random.default_rng(SEED)
    out = np.empty_like(images)
    for s, image in enumerate(images):
        precision = _Precision(projector, weights[s], prior.only(s), image, non_negative=non_negative)
        total = np.zeros(image.shape)
        for start in range(0, samples, BLOCK):
            drawn = precision.sample(rng, min(BLOCK, samples - start), iterations)
            total += np.square(drawn, dtype=np.float64).sum(axis=0)
            part_of(on_progress, s / len(images), 1.0 / len(images))(min(start + BLOCK, samples) / samples)
        out[s] = np.sqrt(total / samples)
    return out


class _Precision:
    """H at one image, on the pixels that are free."""

    def __init__(
        self, projector: Projector, weights: Images, prior: Prior, image: Images, *, non_negative: bool
    ) -> None:
        self.projector, self.weights = projector, weights
        self.free = (image > 0.0).astype(np.float32) if non_negative else np.ones_like(image)
        dx, dy = _differences(image[None])
        ratio = 1.0 + (dx**2 + dy**2)[0] / prior.scale[0] ** 2
        self.curvature = prior.curvature(0, ratio).astype(np.float32)
        self.corner = float(2.0 * prior.corner_strength()[0] / (prior.corner[0] ** 2 + float(image[-1, -1]) ** 2))

    def __call__(self, images: Images) -> Images:
        out: Images = self.projector.adjoint(self.projector.forward(images) * self.weights)
        dx, dy = _differences(images)
        out += _transposed(self.curvature * dx, self.curvature * dy)
        out[:, -1, -1] += np.float32(self.corner) * images[:, -1, -1]
        return out * self.free

    def sample(self, rng: np.random.Generator, count: int, iterations: int) -> Images:
        """Samples (count, n, n) of the Gaussian, by conjugate gradients preconditioned with H's diagonal."""
        n = self.projector.grid.size

        def white(*shape: int) -> Images:
            return rng.standard_normal((count, *shape), dtype=np.float32)

        root = np.sqrt(self.curvature)
        right = self.projector.adjoint(white(*self.weights.shape) * np.sqrt(self.weights))
        right += _transposed(root * white(n - 1, n - 1), root * white(n - 1, n - 1))
        right[:, -1, -1] += np.float32(np.sqrt(self.corner)) * white()
        return self._solve(right * self.free, iterations)

    def _solve(self, right: Images, iterations: int) -> Images:
        inverse = np.divide(self.free, np.maximum(self._diagonal(), np.float32(1e-30)), dtype=np.float32)
        x, r = np.zeros_like(right), right.copy()
        z: Images = inverse * r
        p, rz = z.copy(), _dots(r, z)
        limit = TOLERANCE**2 * rz
        for _ in range(iterations):
            if (rz <= limit).all():
                break
            hp = self(p)
            step = _column(rz / np.maximum(_dots(p, hp), 1e-300))
            x += step * p
            r -= step * hp
            z = inverse * r
            following = _dots(r, z)
            p = z + _column(following / np.maximum(rz, 1e-300)) * p
            rz = following
        return x

    def _diagonal(self) -> Images:
        """H's diagonal; the data's part by a pixel's mean chord, which is exact enough to precondition."""
        pixel = np.float32(0.8 * self.projector.grid.pixel_mm)
        diagonal: Images = self.projector.adjoint(self.weights) * pixel
        diagonal[:-1, :-1] += 2.0 * self.curvature
        diagonal[1:, :-1] += self.curvature
        diagonal[:-1, 1:] += self.curvature
        diagonal[-1, -1] += np.float32(self.corner)
        return diagonal


def _differences(images: Images) -> tuple[Images, Images]:
    """To the next pixel along x and along y, where both exist: each (images, n - 1, n - 1)."""
    here = images[:, :-1, :-1]
    return images[:, 1:, :-1] - here, images[:, :-1, 1:] - here


def _transposed(dx: Images, dy: Images) -> Images:
    count, m, _ = dx.shape
    out = np.zeros((count, m + 1, m + 1), np.float32)
    out[:, 1:, :-1] += dx
    out[:, :-1, 1:] += dy
    out[:, :-1, :-1] -= dx + dy
    return out


def _dots(a: Images, b: Images) -> Floats:
    return np.asarray(np.einsum("sij,sij->s", a, b, dtype=np.float64))


def _column(values: Floats) -> Images:
    return values.astype(np.float32)[:, None, None]
