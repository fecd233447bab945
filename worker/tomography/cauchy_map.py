"""The most probable image under independent noise and Cauchy-distributed differences: flat wood, sharp edges."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worker.tomography.geometry import GeometryError
from worker.tomography.iterative.descent import Floats, Images, Indices, Progress
from worker.tomography.iterative.holding_out import HELD_SHARE, hold_out
from worker.tomography.iterative.penalised import (
    FACTORS,
    Inside,
    Objective,
    Prior,
    descend,
    mean_along_rays,
    typical_attenuation,
    widely,
)
from worker.tomography.iterative.posterior import posterior_deviation
from worker.tomography.noise import data_misfit, noise_of_each_ray, remarks_on
from worker.tomography.projector import Image, Projector

# The density's exponent in the plane (design page, section 4).
STRENGTH = 1.5
# Of the attenuation that a blurred first image mostly has. Found on simulated logs (benchmarks/choosing.py).
BETA_SHARE = 0.4
# Sigma as multiples of the noise that are tried when it is not given.
SIGMA_FACTORS = np.geomspace(0.5, 2.5, 5)
# With the rays kept back among them again, the data are to weigh no more against the prior than without: on simulated
# logs (benchmarks/choosing.py), a little less.
ALL_RAYS = 1.0 / (1.0 - HELD_SHARE)
ITERATIONS = 300
TOLERANCE = 2e-4


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
    progress: Progress | None = None,
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
        same for all slices, by which rays kept back from the middle slice are foretold best.
    beta : float, optional
        Scale of the differences between neighbouring pixels, in attenuation; by default a share of the wood's.
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
        Called after each iteration of the last descent with the number done and the most there may be.

    Raises
    ------
    GeometryError
        If shapes do not fit or a value is not positive.
    """
    lines = projector.block(sinogram)
    noises = noise_of_each_ray(noise, lines)
    corner = None
    if preset is not None:
        settings = PRESETS[preset]
        sigma, beta, corner = settings.sigma, settings.beta, settings.boundary
        iterations, non_negative = settings.iterations, settings.non_negative
    # The bound leaves little to find in the air around the log: only the last descent looks there.
    inside = Inside.of(projector, lines) if non_negative else Inside.all_of(projector)
    start = mean_along_rays(inside.projector, lines)
    betas = _betas(beta, start)
    if sigma is None:
        factor, start = _foretelling(inside.projector, lines, noises, betas, start, non_negative=non_negative)
        sigmas = factor * noises
    else:
        sigmas = noise_of_each_ray(sigma, lines)
    weights = np.broadcast_to(1.0 / sigmas**2, lines.shape).astype(np.float32)
    prior = Prior(
        "cauchy", betas, np.full(betas.shape, STRENGTH), betas if corner is None else np.full(betas.shape, corner)
    )
    if preset is None and (sigma is not None or len(lines) > 1):
        near = Objective(inside.projector, lines, weights, prior)
        start = widely(near, start, FACTORS[0], non_negative=non_negative, tolerance=tolerance)
    found = descend(
        Objective(projector, lines, weights, prior),
        inside.whole(start),
        non_negative=non_negative,
        iterations=iterations,
        tolerance=tolerance,
        factors=(1.0,),
        # The published iterations end long before the objective is at rest, and where they end is the method.
        guided=preset is None,
        progress=progress,
    )
    images = found.images
    misfit = data_misfit(projector, images, lines, noises)
    deviation = (
        posterior_deviation(projector, weights, prior, images, non_negative=non_negative) if uncertainty else None
    )
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


def _betas(beta: float | None, start: Images) -> Floats:
    """The scale for each slice: as given, or a share of the attenuation that its mass mostly has."""
    if beta is not None:
        if not (np.isfinite(beta) and beta > 0.0):
            raise GeometryError(f"beta must be a positive attenuation, not {beta}")
        return np.full(len(start), float(beta))
    return BETA_SHARE * typical_attenuation(start)


def _foretelling(
    projector: Projector, lines: Images, noises: Floats, betas: Floats, start: Images, *, non_negative: bool
) -> tuple[float, Images]:
    """The factor between sigma and noise from the middle slice, and where to start from."""
    middle = len(lines) // 2
    noise = np.broadcast_to(noises, lines.shape)[middle]
    scale = np.full(SIGMA_FACTORS.size, betas[middle])
    objective = Objective(
        projector,
        lines[middle : middle + 1],
        (1.0 / (SIGMA_FACTORS[:, None, None] * noise) ** 2).astype(np.float32),
        Prior("cauchy", scale, np.full(scale.shape, STRENGTH), scale),
    )
    outcome = hold_out(objective, noise, start[middle], non_negative=non_negative)
    return ALL_RAYS * outcome.best(SIGMA_FACTORS), outcome.images[outcome.nearest][None] if len(lines) == 1 else start
