"""The most probable image under independent noise and Cauchy-distributed differences: flat wood, sharp edges."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_worker.tomography.geometry import GeometryError
from sawmill_worker.tomography.iterative.descent import Floats, Images, Indices, Progress
from sawmill_worker.tomography.iterative.holding_out import bottom, hold_out
from sawmill_worker.tomography.iterative.penalised import (
    WIDE_ITERATIONS,
    Inside,
    Objective,
    Prior,
    descend_outwards,
    mean_along_rays,
    typical_attenuation,
    widely,
)
from sawmill_worker.tomography.iterative.posterior import posterior_deviation
from sawmill_worker.tomography.iterative.rehearsing import ITERATIONS as TRIAL_ITERATIONS
from sawmill_worker.tomography.iterative.rehearsing import Rehearsal
from sawmill_worker.tomography.iterative.telling import Phases, Told, descending, part_of, side_by_side
from sawmill_worker.tomography.noise import data_misfit, noise_of_each_ray, remarks_on
from sawmill_worker.tomography.object_extent import check_shown
from sawmill_worker.tomography.projector import Image, Projector
from sawmill_worker.tomography.total_variation import choose_weight, total_variation

# The density's exponent in the plane (design page, section 4).
STRENGTH = 1.5
# Of the attenuation that a blurred first image mostly has, over the square root of the pixels across the log: with
# smaller pixels slopes differ less from one to the next, edges as much as ever. This and all that follows was found on
# simulated logs (benchmarks/choosing.py).
BETA_SHARE = 4.7
# Sigma as multiples of the noise that are tried with it, when it is not given.
SIGMA_FACTORS = np.geomspace(0.6, 3.0, 5)
# Betas that are tried, as multiples of that share, and the power of beta with which the best sigma goes about.
BETA_STEPS = 8.0 ** np.linspace(-0.75, 0.25, 5)
RIDGE = 0.6
# Multiples of the sigma so foretold that are tried with each.
NEAR_FACTORS = np.geomspace(0.7, 1.0 / 0.7, 3)
# A beta is judged by the edges in views kept back, too: the exponent of their frequencies, how many times the logarithm
# of what is missed counts beside that of the rehearsal's squared distances, and the iterations of those images. By so
# much more, times the logarithm of the step, must a beta other than the usual one be better.
EDGES, TRUST, FORETELLING_ITERATIONS = 1.5, 30.0, 8
HANDICAP = 0.4
# The image that is compared with need not be at rest.
KNOWN_TOLERANCE = 1e-3
ITERATIONS = 400
TOLERANCE = 2e-5
# Iterations after which most logs are at rest.
USUAL_ITERATIONS = 40
# What choosing sigma and beta costs, and each slice's uncertainty, in iterations on one slice.
CHOOSING_COST, DEVIATION_COST = 800.0, 270.0
# Of choosing: the weight of total variation, its image, and what is tried. Measured on 256 x 256 pixels from 20 views.
WEIGHT_COST, KNOWN_COST, SIGMA_COST, BETA_COST, FORETOLD_COST = 0.29, 0.02, 0.07, 0.41, 0.21


@dataclass(frozen=True)
class Preset:
    """Settings taken together; a boundary is the scale that holds the corner pixel."""

    sigma: float
    beta: float
    boundary: float
    iterations: int
    non_negative: bool


# As published for logs from few views (arXiv 2206.14444): in the unit of that log, whose wood is about 0.4.
PRESETS = {"paper": Preset(sigma=0.3, beta=0.01, boundary=0.1, iterations=150, non_negative=False)}


@dataclass(frozen=True, eq=False)
class CauchyMap:
    """The reconstruction and what led to it.

    Attributes
    ----------
    image : (size, size) or (slices, size, size) float32
        [x, y], in the sinogram's unit per mm.
    sigma : float
        Root mean square over the rays of the standard deviation that the density took.
    beta : (slices,) float64
        Scale of the differences between neighbouring pixels, in the image's unit.
    objective : (slices,) float64
        1/2 sum ((A x - y) / sigma)^2 + 3/2 sum log(1 + |d|^2 / beta^2): zero for a flat image that explains the data.
    iterations, converged : (slices,)
        Of the descent with the sharp prior.
    noise : float
        Root mean square of the data's noise, given or estimated.
    misfit : (slices,) float64
        Root mean square of (A x - y) / noise: near 1 where geometry and noise are right, far above where not.
    deviation : like image, or None
        Standard deviation of each pixel, where asked for.
    remarks : tuple of str
    """

    image: Image
    sigma: float
    beta: Floats
    objective: Floats
    iterations: Indices
    converged: NDArray[np.bool_]
    noise: float
    misfit: Floats
    deviation: Image | None
    remarks: tuple[str, ...]


def cauchy_map(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    sigma: ArrayLike | None = None,
    beta: float | None = None,
    noise: ArrayLike | None = None,
    preset: Literal["paper"] | None = None,
    non_negative: bool = True,
    uncertainty: bool = False,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    progress: Told | None = None,
) -> CauchyMap:
    """Reconstruct one slice or a block of slices (design page, section 4).

    Parameters
    ----------
    projector : Projector
        Geometry and image grid; any angles.
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air stands at 0.
    sigma : float or (views, detector), optional
        Standard deviation that the density takes, in the sinogram's unit. By default a multiple of the noise, the
        same for all slices, which `choose` takes for the middle one.
    beta : float, optional
        Scale of the differences between neighbouring pixels, in attenuation; by default chosen together with sigma,
        or a share of the wood's where sigma is given.
    noise : float or (views, detector), optional
        Standard deviation of the data, for sigma and the misfit: `photon_noise` where counts are known; by default
        that of the air.
    preset : {"paper"}, optional
        The published settings, in place of sigma, beta, non_negative and iterations.
    non_negative : bool
        Attenuation is at least 0.
    uncertainty : bool
        Whether each pixel's standard deviation is wanted too (see `posterior_deviation`).
    iterations, tolerance
        The descent ends when its last iterations lower the objective by less than this share, or are used up.
    progress : callable, optional
        Told the share of all the work that is done, which rises to 1, after each iteration.

    Raises
    ------
    GeometryError
        If shapes do not fit, a value is not positive, or a slice is 0 in every ray.
    """
    lines = projector.block(sinogram)
    check_shown(lines)
    noises = noise_of_each_ray(noise, lines)
    corner = None
    if preset is not None:
        settings = PRESETS[preset]
        sigma, beta, corner = settings.sigma, settings.beta, settings.boundary
        iterations, non_negative = settings.iterations, settings.non_negative
    # The bound leaves little to find in the air around the log: only the last descent looks there.
    inside = Inside.of(projector, lines, non_negative=non_negative)
    alone = sigma is None and len(lines) == 1
    phases = Phases(
        progress,
        choose=CHOOSING_COST if sigma is None else 0.0,
        widened=0.0 if alone or preset is not None else WIDE_ITERATIONS * side_by_side(len(lines)),
        sharp=USUAL_ITERATIONS * side_by_side(len(lines)),
        deviation=DEVIATION_COST * len(lines) if uncertainty else 0.0,
    )
    if sigma is None:
        middle = len(lines) // 2
        choice = choose(
            inside.projector,
            lines[middle],
            beta=beta,
            noise=np.broadcast_to(noises, lines.shape)[middle],
            non_negative=non_negative,
            progress=phases.of("choose"),
        )
        sigmas, betas = choice.factor * noises, np.full(len(lines), choice.beta)
        start = choice.image[None] if alone else mean_along_rays(inside.projector, lines)
    else:
        start = mean_along_rays(inside.projector, lines)
        sigmas, betas = noise_of_each_ray(sigma, lines), _betas(beta, start)
    weights = np.broadcast_to(1.0 / sigmas**2, lines.shape).astype(np.float32)
    prior = _prior(betas, corner)
    if preset is None and not alone:
        near = Objective(inside.projector, lines, weights, prior)
        reporting = phases.descent("widened", WIDE_ITERATIONS)
        start = widely(near, start, non_negative=non_negative, tolerance=tolerance, progress=reporting)
    found = descend_outwards(
        Objective(projector, lines, weights, prior),
        inside,
        start,
        non_negative=non_negative,
        iterations=iterations,
        tolerance=tolerance,
        usual=USUAL_ITERATIONS,
        # The published iterations end long before the objective is at rest, and where they end is the method.
        guided=preset is None,
        told=phases.of("sharp"),
    )
    images = found.images
    misfit = data_misfit(projector, images, lines, noises)
    deviation = None
    if uncertainty:
        deviation = posterior_deviation(
            projector, weights, prior, images, non_negative=non_negative, told=phases.of("deviation")
        )
    phases.of("deviation")(1.0)
    shape = images.shape if np.ndim(sinogram) == 3 else images.shape[1:]
    return CauchyMap(
        image=images.reshape(shape),
        sigma=float(np.sqrt(np.mean(sigmas**2))),
        beta=betas,
        objective=found.values,
        iterations=found.iterations,
        converged=found.converged,
        noise=float(np.sqrt(np.mean(noises**2))),
        misfit=misfit,
        deviation=None if deviation is None else deviation.reshape(shape),
        remarks=(found.remarks if preset is None else ()) + remarks_on(misfit, lines, noises),
    )


@dataclass(frozen=True, eq=False)
class Choice:
    """What suits one slice.

    Attributes
    ----------
    factor : float
        Sigma as a multiple of the noise.
    beta : float
    image : (size, size) float32
        Near to what they lead to.
    """

    factor: float
    beta: float
    image: Image


def choose(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    beta: float | None = None,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    progress: Told | None = None,
) -> Choice:
    """Sigma and beta for a sinogram (views, detector).

    How smooth an image is best, sigma and beta together, shows a rehearsal on what total variation makes of the slice
    (`Rehearsal`); whether by many small steps or by few large ones, beta, views that are kept back (`hold_out`).

    Parameters as of `cauchy_map`; a given beta stays.
    """
    lines = projector.block(sinogram)
    check_shown(lines)
    noises = noise_of_each_ray(noise, lines)
    inside = Inside.of(projector, lines, non_negative=non_negative)
    near, line = inside.projector, lines[0]
    middle = float(_betas(beta, mean_along_rays(near, lines))[0])
    open_beta = beta is None
    phases = Phases(
        progress,
        weight=WEIGHT_COST,
        known=KNOWN_COST,
        sigma=SIGMA_COST,
        beta=BETA_COST if open_beta else 0.0,
        foretold=FORETOLD_COST if open_beta else 0.0,
    )
    smooth = choose_weight(near, line, noise=noises[0], non_negative=non_negative, progress=phases.of("weight"))
    known = total_variation(
        near,
        line,
        weight=smooth.weight,
        noise=noises[0],
        non_negative=non_negative,
        tolerance=KNOWN_TOLERANCE,
        progress=phases.of("known"),
    )
    rehearsal = Rehearsal.of(near, line, noises[0], known.image, non_negative=non_negative)
    first = _best_sigma(rehearsal, noises, middle, SIGMA_FACTORS, None, phases.descent("sigma", TRIAL_ITERATIONS))
    if not open_beta:
        return Choice(first.factor, middle, inside.whole(first.images[:1])[0])
    betas = middle * BETA_STEPS
    ridge = _ridge(rehearsal, noises, betas, first, phases.of("beta"))
    factors = np.array([best.factor for best in ridge])
    foretold = hold_out(
        Objective(near, lines, _weights(factors, noises, lines), _prior(betas)),
        noises[0],
        smooth.images,
        exponent=EDGES,
        iterations=FORETELLING_ITERATIONS,
        non_negative=non_negative,
        told=phases.of("foretold"),
    )
    away = HANDICAP * np.abs(np.log(BETA_STEPS))
    errors = np.array([best.error for best in ridge]) + TRUST * np.log(foretold.in_views) + away
    found, _ = bottom(betas, errors)
    factor = math.exp(np.interp(math.log(found), np.log(betas), np.log(factors)))
    return Choice(factor, found, inside.whole(ridge[np.argmin(errors)].images[:1])[0])


class _Best(NamedTuple):
    """The best sigma for a beta, as a multiple of the noise, its error and its images (2, n, n) as of `Tried`."""

    factor: float
    error: float
    images: Images


def _best_sigma(
    rehearsal: Rehearsal, noises: Floats, beta: float, factors: Floats, start: Images | None, progress: Progress
) -> _Best:
    weights = _weights(factors, noises, rehearsal.lines[:1])
    tried = rehearsal.try_out(weights, _prior(np.full(factors.size, beta)), start, progress)
    return _Best(*bottom(factors, tried.errors), tried.images[np.argmin(tried.errors)])


def _ridge(rehearsal: Rehearsal, noises: Floats, betas: Floats, middle: _Best, told: Told) -> list[_Best]:
    """The best sigma for each beta, sought around where the middle one's foretells it."""
    return [
        _best_sigma(
            rehearsal,
            noises,
            beta,
            middle.factor * step**RIDGE * NEAR_FACTORS,
            middle.images,
            descending(part_of(told, index / betas.size, 1.0 / betas.size), TRIAL_ITERATIONS),
        )
        for index, (beta, step) in enumerate(zip(betas, BETA_STEPS, strict=True))
    ]


def _weights(factors: Floats, noises: Floats, lines: Images) -> Images:
    """1 / sigma^2 for multiples of the noise, (factors, views, detector)."""
    each = 1.0 / (factors[:, None, None] * noises) ** 2
    return np.broadcast_to(each, (factors.size, *lines.shape[1:])).astype(np.float32)


def _prior(betas: Floats, corner: float | None = None) -> Prior:
    corners = betas if corner is None else np.full(betas.shape, corner)
    return Prior("cauchy", betas, np.full(betas.shape, STRENGTH), corners)


def _betas(beta: float | None, start: Images) -> Floats:
    """The scale for each slice: as given, or a share of the attenuation that its mass mostly has.

    `start` shows the pixels among which the log lies (slices, n, n).
    """
    if beta is not None:
        if not (np.isfinite(beta) and beta > 0.0):
            raise GeometryError(f"beta must be a positive attenuation, not {beta}")
        return np.full(len(start), float(beta))
    return BETA_SHARE / math.sqrt(start.shape[-1]) * typical_attenuation(start)
