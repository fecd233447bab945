"""Smoothed total variation: convex, and the yardstick that other edge-preserving methods are measured with."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_worker.tomography.geometry import GeometryError
from sawmill_worker.tomography.iterative.descent import Floats, Indices
from sawmill_worker.tomography.iterative.holding_out import bottom, hold_out, shown_without
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
from sawmill_worker.tomography.iterative.telling import Phases, Told, side_by_side
from sawmill_worker.tomography.noise import data_misfit, noise_of_each_ray, remarks_on
from sawmill_worker.tomography.object_extent import check_shown
from sawmill_worker.tomography.projector import Image, Projector

# Differences below this share of the wood's attenuation are smoothed quadratically.
SMOOTHING_SHARE = 0.02
# Weights tried when none is given, times the typical attenuation: what a difference as large as wood costs.
WEIGHTS = np.geomspace(1.1, 60.0, 5)
# Times the weight that foretells best: with all views and rays among them again the data weigh more, and an image is
# nearest to its log where it is somewhat smoother than foretells views best. Found on simulated logs
# (benchmarks/choosing.py).
SMOOTHER = 1.55
TRIAL_ITERATIONS = 8
# What the widened prior costs beside the weights tried.
WIDENED_COST = 0.25
ITERATIONS = 300
TOLERANCE = 1e-4
# Iterations after which most logs are at rest.
USUAL_ITERATIONS = 30
# What choosing the weight costs, in iterations on one slice; measured on 256 x 256 pixels from 20 views.
CHOOSING_COST = 210.0


@dataclass(frozen=True, eq=False)
class TotalVariation:
    """The reconstruction and what led to it.

    Attributes
    ----------
    image : (size, size) or (slices, size, size) float32
        [x, y], in the sinogram's unit per mm.
    weight : (slices,) float64
        Of the variation, in 1 / attenuation.
    objective : (slices,) float64
        1/2 sum ((A x - y) / noise)^2 + weight * sum (sqrt(|d|^2 + s^2) - s).
    iterations, converged, noise, misfit, remarks
        As of `CauchyMap`.
    """

    image: Image
    weight: Floats
    objective: Floats
    iterations: Indices
    converged: NDArray[np.bool_]
    noise: float
    misfit: Floats
    remarks: tuple[str, ...]


def total_variation(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    weight: float | None = None,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    progress: Told | None = None,
) -> TotalVariation:
    """Reconstruct one slice or a block of slices by penalising the sum of differences (Rudin, Osher and Fatemi 1992).

    Parameters
    ----------
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air stands at 0.
    weight : float, optional
        In 1 / attenuation; by default somewhat more than that by which views and rays kept back from the middle slice
        are foretold best.
    noise, non_negative, iterations, tolerance, progress
        As of `cauchy_map`.

    Raises
    ------
    GeometryError
        If shapes do not fit, a value is not positive, or a slice is 0 in every ray.
    """
    if weight is not None and not (np.isfinite(weight) and weight > 0.0):
        raise GeometryError(f"weight must be a positive number in 1 / attenuation, not {weight}")
    lines = projector.block(sinogram)
    check_shown(lines)
    noises = noise_of_each_ray(noise, lines)
    weights = np.broadcast_to(1.0 / noises**2, lines.shape).astype(np.float32)
    inside = Inside.of(projector, lines, non_negative=non_negative)
    start = mean_along_rays(inside.projector, lines)
    typical = typical_attenuation(start)
    alone = weight is None and len(lines) == 1
    phases = Phases(
        progress,
        choose=CHOOSING_COST if weight is None else 0.0,
        widened=0.0 if alone else WIDE_ITERATIONS * side_by_side(len(lines)),
        sharp=USUAL_ITERATIONS * side_by_side(len(lines)),
    )
    if weight is None:
        middle = len(lines) // 2
        noise_here = np.broadcast_to(noises, lines.shape)[middle]
        choice = choose_weight(
            inside.projector, lines[middle], noise=noise_here, non_negative=non_negative, progress=phases.of("choose")
        )
        weight = choice.weight
        start = choice.images.mean(axis=0, keepdims=True) if alone else start
    strengths = np.full(typical.shape, weight)
    prior = _prior(typical, strengths)
    if not alone:
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
        told=phases.of("sharp"),
    )
    images = found.images
    misfit = data_misfit(projector, images, lines, noises)
    phases.of("sharp")(1.0)
    return TotalVariation(
        image=images.reshape(images.shape if np.ndim(sinogram) == 3 else images.shape[1:]),
        weight=strengths,
        objective=found.values,
        iterations=found.iterations,
        converged=found.converged,
        noise=float(np.sqrt(np.mean(noises**2))),
        misfit=misfit,
        remarks=found.remarks + remarks_on(misfit, lines, noises),
    )


@dataclass(frozen=True, eq=False)
class WeightChoice:
    """What suits one slice.

    Attributes
    ----------
    weight : float
    images : (rounds, size, size) float32
        Near to what it finds without what each round keeps back.
    """

    weight: float
    images: Image


def choose_weight(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    progress: Told | None = None,
) -> WeightChoice:
    """The weight that `total_variation` takes by itself for a sinogram (views, detector).

    Parameters as of `total_variation`, for one sinogram.
    """
    lines = projector.block(sinogram)
    check_shown(lines)
    noises = noise_of_each_ray(noise, lines)
    inside = Inside.of(projector, lines, non_negative=non_negative)
    start = mean_along_rays(inside.projector, lines)
    typical = typical_attenuation(start)
    tried = WEIGHTS / typical
    weights = np.broadcast_to(1.0 / noises**2, lines.shape).astype(np.float32)
    objective = Objective(inside.projector, lines, weights, _prior(np.broadcast_to(typical, tried.shape), tried))
    phases = Phases(progress, widened=WIDENED_COST, tried=1.0)
    # What the widened prior shows is much the same for all weights: the middle one's serves them.
    shown = shown_without(
        objective.only(tried.size // 2), start[0], non_negative=non_negative, told=phases.of("widened")
    )
    outcome = hold_out(
        objective,
        noises[0],
        shown,
        exponent=1.0,
        iterations=TRIAL_ITERATIONS,
        non_negative=non_negative,
        told=phases.of("tried"),
    )
    errors = np.log(outcome.in_views) + np.log(outcome.in_rays)
    weight, _ = bottom(tried, errors)
    return WeightChoice(SMOOTHER * weight, inside.whole(outcome.images[:, np.argmin(errors)]))


def _prior(typical: Floats, strengths: Floats) -> Prior:
    scale = SMOOTHING_SHARE * typical
    return Prior("total-variation", scale, strengths, typical)
