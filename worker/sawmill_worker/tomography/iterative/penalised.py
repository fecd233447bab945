"""Weighted least squares with an edge-preserving prior, and its descent from a smooth prior to the sharp one."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numba import get_num_threads
from scipy.fft import fftfreq, irfft2, next_fast_len, rfft2, rfftfreq

from sawmill_worker.tomography.geometry import GeometryError
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.iterative import _prior_numba as kernels
from sawmill_worker.tomography.iterative.descent import Floats, Images, Indices, Minimum, Progress, minimise
from sawmill_worker.tomography.iterative.telling import Phases, Told
from sawmill_worker.tomography.object_extent import object_radius_mm
from sawmill_worker.tomography.projector import Projector

# The densities are not log-concave: one so many times as wide shows the way to the sharp one's better valleys.
WIDENING = 8.0
WIDE_ITERATIONS = 15
# Where the pixels around a log are more than this share of all, a descent among them first saves nothing.
FEW = 0.6
# The share of the iterations that such a descent may take, for the air beside the log wants some too.
NEAR_SHARE = 2.0 / 3.0
# Iterations everywhere after which most images whose log was at rest are so too, and what they cost beside those among
# the log's pixels.
LAST_ITERATIONS, LAST_COST = 20, 0.8
# Pixels kept around what the scan shows.
MARGIN = 2
# Of the picture that shows the data's curvature: equal data give equal answers.
SEED = 22


@dataclass(frozen=True, eq=False)
class Prior:
    """A penalty on the differences d to the next pixels, one scale and one strength for each image.

    cauchy : strength * sum log(1 + |d|^2 / scale^2)
    total-variation : strength * scale * sum (sqrt(1 + |d|^2 / scale^2) - 1)
    """

    kind: Literal["cauchy", "total-variation"]
    scale: Floats
    strength: Floats
    # Weak hold of the corner pixel that has no difference; in the unit of attenuation, as scale is.
    corner: Floats

    def add(self, images: Images, which: Indices, gradient: Images) -> Floats:
        """Add the gradient in place; returns the values."""
        bands = np.empty((len(images), -(-images.shape[1] // kernels.BAND)))
        kernel = kernels.cauchy if self.kind == "cauchy" else kernels.total_variation
        kernel(images, self.scale[which], self.strength[which], gradient, bands)
        corner, strength = images[:, -1, -1].astype(np.float64), self.corner_strength()[which]
        square = self.corner[which] ** 2
        gradient[:, -1, -1] += strength * 2.0 * corner / (square + corner**2)
        return np.asarray(bands.sum(axis=1) + strength * np.log1p(corner**2 / square))

    def stiffest(self) -> Floats:
        """Curvature over a difference of 0, for each image."""
        return np.asarray(2.0 * self.strength / self.scale**2 if self.kind == "cauchy" else self.strength / self.scale)

    def corner_strength(self) -> Floats:
        """Of the hold of the corner pixel; a pure number, as an objective is."""
        return self.strength if self.kind == "cauchy" else self.strength * self.scale

    def only(self, index: int) -> "Prior":
        """One image's."""
        one = slice(index, index + 1)
        return Prior(self.kind, self.scale[one], self.strength[one], self.corner[one])

    def each(self, times: int) -> "Prior":
        """For so many copies of each image, one after the other."""
        return Prior(self.kind, *(np.repeat(of, times) for of in (self.scale, self.strength, self.corner)))

    def widened(self, factor: float) -> "Prior":
        """The same with its scale multiplied."""
        return Prior(self.kind, self.scale * factor, self.strength, self.corner * factor)


@dataclass(frozen=True, eq=False)
class Objective:
    """1/2 sum weights (A x - y)^2 + prior, for several images side by side.

    Attributes
    ----------
    lines, weights : (images, views, detector) float32
        The weights are 1 / sigma^2; 0 for a ray that is left out. Either may have one image that serves all.
    """

    projector: Projector
    lines: Images
    weights: Images
    prior: Prior

    def only(self, index: int) -> "Objective":
        """One image's."""
        which = np.array([index])
        return replace(
            self, lines=_of(self.lines, which), weights=_of(self.weights, which), prior=self.prior.only(index)
        )

    def __call__(self, images: Images, which: Indices) -> tuple[Floats, Images]:
        """Values (named,) and gradients (named, n, n)."""
        residual = self.projector.forward(images) - _of(self.lines, which)
        weighted = residual * _of(self.weights, which)
        gradient = self.projector.adjoint(weighted)
        values = 0.5 * np.einsum("skm,skm->s", residual, weighted, dtype=np.float64)
        return values + self.prior.add(images, which, gradient), gradient


class Curvature:
    """First guess of an objective's inverse curvature: even ground everywhere, then each pixel's own share of it.

    Over even ground of the stiffness k the curvature is c / |w| + k |w|^2 at the frequency w: the data's, whose adjoint
    projection blurs by 1 / |w| (Natterer 2001, section 2.1), and the prior's. c follows from the mean diagonal of
    A^T W A, which a picture of random signs shows.
    """

    def __init__(self, objective: Objective) -> None:
        self._prior = objective.prior
        n = objective.projector.grid.size
        signs = np.random.default_rng(SEED).choice(np.array([-1.0, 1.0], np.float32), (n, n))
        seen = np.square(objective.projector.forward(signs))
        total = np.einsum("skm,km->s", objective.weights, seen, dtype=np.float64) / n**2
        stiffest = objective.prior.stiffest()
        self._data = np.broadcast_to(total, stiffest.shape)
        frequency = 2.0 * np.pi * np.hypot(fftfreq(n)[:, None], fftfreq(n))
        frequency[0, 0] = np.pi / n
        blur = 1.0 / frequency
        blur /= blur.mean()
        rough = 4.0 * (np.sin(np.pi * fftfreq(n))[:, None] ** 2 + np.sin(np.pi * rfftfreq(n)) ** 2)
        curvature = self._data[:, None, None] * blur[:, : n // 2 + 1] + stiffest[:, None, None] * rough
        self._inverse = (1.0 / curvature).astype(np.float32)

    def shares(self, images: Images, which: Indices) -> Images:
        """How much softer each pixel is than even ground, (named, n, n), as a square root."""
        out = np.empty_like(images)
        prior = self._prior
        power = 1.0 if prior.kind == "cauchy" else 0.5
        kernels.shares(images, prior.scale[which], prior.stiffest()[which], self._data[which], power, out)
        return out

    def smoothed(self, images: Images, which: Indices) -> Images:
        """The inverse curvature over even ground."""
        threads, shape = get_num_threads(), images.shape[1:]
        spectrum = rfft2(images, workers=threads)
        spectrum *= self._inverse[which]
        return np.asarray(irfft2(spectrum, s=shape, workers=threads, overwrite_x=True))


def _of(rays: Images, which: Indices) -> Images:
    return rays if len(rays) == 1 else rays[which]


def descend(
    objective: Objective,
    start: Images,
    *,
    non_negative: bool,
    iterations: int,
    tolerance: float,
    guided: bool = True,
    progress: Progress | None = None,
) -> Minimum:
    """Minimise from where `widely`, or another image, leads.

    `guided` descends with a first guess of the curvature; without it the path is that of the plain quasi-Newton method.
    """
    return minimise(
        objective,
        start,
        lower=0.0 if non_negative else -np.inf,
        iterations=iterations,
        tolerance=tolerance,
        guess=Curvature(objective) if guided else None,
        progress=progress,
    )


def widely(
    objective: Objective,
    start: Images,
    *,
    non_negative: bool,
    tolerance: float,
    progress: Progress | None = None,
) -> Images:
    """Some iterations with the prior widened."""
    wide = replace(objective, prior=objective.prior.widened(WIDENING))
    return descend(
        wide,
        start,
        non_negative=non_negative,
        iterations=WIDE_ITERATIONS,
        tolerance=tolerance,
        guided=False,
        progress=progress,
    ).images


@dataclass(frozen=True, eq=False)
class Inside:
    """The pixels among which a log lies, the others being air.

    Attributes
    ----------
    projector : Projector
        On those pixels alone.
    part : (slice, slice)
        Where they lie in the whole image.
    size : int
        Of the whole image.
    """

    projector: Projector
    part: tuple[slice, slice]
    size: int

    @classmethod
    def of(cls, projector: Projector, lines: Images, *, non_negative: bool = True) -> "Inside":
        """What all slices (slices, views, detector) show, with a margin, in a size that transforms quickly.

        Every pixel where a slice shows nothing but air, and where air may be less than nothing.
        """
        if not non_negative:
            return cls.all_of(projector)
        grid = projector.grid
        radii = [object_radius_mm(projector.geometry, line) for line in lines]
        if min(radii) == 0.0:
            return cls.all_of(projector)
        radius = max(radii) + MARGIN * grid.pixel_mm
        ends = [
            (math.floor((-radius - low) / grid.pixel_mm), math.ceil((radius - low) / grid.pixel_mm))
            for low in grid.low_mm
        ]
        ends = [(max(low, 0), min(high, grid.size)) for low, high in ends]
        size = next_fast_len(max(1, *(high - low for low, high in ends)), real=True)
        # Around the middle of a field around the COR, where views a quarter turn apart are faster.
        while (grid.size - size) % 2:
            size = next_fast_len(size + 1, real=True)
        size = min(size, grid.size)
        low_x, low_y = (min(max((low + high - size) // 2, 0), grid.size - size) for low, high in ends)
        field = size * grid.pixel_mm
        centre = (
            grid.low_mm[0] + low_x * grid.pixel_mm + 0.5 * field,
            grid.low_mm[1] + low_y * grid.pixel_mm + 0.5 * field,
        )
        part = slice(low_x, low_x + size), slice(low_y, low_y + size)
        return cls(Projector(projector.geometry, ImageGrid(size, field, centre)), part, grid.size)

    @classmethod
    def all_of(cls, projector: Projector) -> "Inside":
        """Every pixel."""
        size = projector.grid.size
        return cls(projector, (slice(size), slice(size)), size)

    @property
    def is_few(self) -> bool:
        """Whether they are so much fewer than all pixels that it pays to look among them first."""
        return self.projector.grid.size**2 < FEW * self.size**2

    def whole(self, images: Images) -> Images:
        """The whole images of those pixels'."""
        out = np.zeros((len(images), self.size, self.size), np.float32)
        out[:, *self.part] = images
        return out


def descend_outwards(
    objective: Objective,
    inside: Inside,
    start: Images,
    *,
    non_negative: bool,
    iterations: int,
    tolerance: float,
    usual: int,
    guided: bool = True,
    told: Told | None = None,
) -> Minimum:
    """Minimise among the pixels inside, where they are few, until that is at rest, and then among all.

    The air answers to the log within some iterations, and the log to the air by little: most of the work needs the
    pixels inside only.

    Parameters
    ----------
    start : (images, inside, inside) float32
        The rest is air.
    iterations : int
        That both descents may take together, the first at most NEAR_SHARE of them.
    usual : int
        Iterations after which most logs are at rest.
    told : callable, optional
        Told the share of the work that is done.
    """
    phases = Phases(told, inside=1.0 if inside.is_few else 0.0, everywhere=LAST_COST)
    spent = np.zeros(len(start), np.int64)
    if inside.is_few:
        near = descend(
            replace(objective, projector=inside.projector),
            start,
            non_negative=non_negative,
            iterations=int(NEAR_SHARE * iterations),
            tolerance=tolerance,
            guided=guided,
            progress=phases.descent("inside", usual),
        )
        start, spent = near.images, near.iterations
    found = descend(
        objective,
        inside.whole(start),
        non_negative=non_negative,
        iterations=iterations - int(spent.max()),
        tolerance=tolerance,
        guided=guided,
        progress=phases.descent("everywhere", LAST_ITERATIONS if inside.is_few else usual),
    )
    return replace(found, iterations=spent + found.iterations)


def mean_along_rays(projector: Projector, lines: Images) -> Images:
    """A first image: each pixel the length-weighted mean, over its rays, of the mean attenuation along each.

    (slices, views, detector) -> (slices, n, n), in attenuation; 0 where no ray passes.
    """
    ones = np.ones((projector.grid.size, projector.grid.size), np.float32)
    lengths = projector.forward(ones)
    crossed = projector.adjoint(np.ones_like(lengths))
    mean = np.divide(lines, lengths, out=np.zeros_like(lines), where=lengths > 0.0)
    image: Images = projector.adjoint(mean)
    return np.divide(image, crossed, out=np.zeros_like(image), where=crossed > 0.0)


def typical_attenuation(images: Images) -> Floats:
    """The attenuation at which a slice mostly has its mass, sum x^2 / sum x, (slices,): of `mean_along_rays`.

    Raises
    ------
    GeometryError
        If a slice has no attenuation anywhere.
    """
    body = np.maximum(images, 0.0).astype(np.float64)
    mass = body.sum(axis=(1, 2))
    if not (mass > 0.0).all():
        raise GeometryError("a slice has no attenuation anywhere, so its scale cannot be chosen: leave it out")
    return np.asarray(np.square(body).sum(axis=(1, 2)) / mass)
