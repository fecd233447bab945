"""Smoothed total variation: convex, and the yardstick that other edge-preserving methods are measured with."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worker.tomography.geometry import GeometryError
from worker.tomography.iterative.descent import Floats, Indices, Progress
from worker.tomography.iterative.holding_out import hold_out
from worker.tomography.iterative.penalised import (
    Inside,
    Objective,
    Prior,
    descend,
    mean_along_rays,
    typical_attenuation,
)
from worker.tomography.noise import data_misfit, noise_of_each_ray, remarks_on
from worker.tomography.projector import Image, Projector

# Differences below this share of the wood's attenuation are smoothed quadratically.
SMOOTHING_SHARE = 0.02
# Weights tried when none is given, times the typical attenuation: what a difference as large as wood costs.
WEIGHTS = np.geomspace(1.0, 100.0, 5)
ITERATIONS = 300
TOLERANCE = 1e-4


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
    progress: Progress | None = None,
) -> TotalVariation:
    """Reconstruct one slice or a block of slices by penalising the sum of differences (Rudin, Osher and Fatemi 1992).

    Parameters
    ----------
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air stands at 0.
    weight : float, optional
        In 1 / attenuation; by default the one by which rays kept back from the middle slice are foretold best.
    noise, non_negative, iterations, tolerance, progress
        As of `cauchy_map`.

    Raises
    ------
    GeometryError
        If shapes do not fit or a value is not positive.
    """
    if weight is not None and not (np.isfinite(weight) and weight > 0.0):
        raise GeometryError(f"weight must be a positive number in 1 / attenuation, not {weight}")
    lines = projector.block(sinogram)
    noises = noise_of_each_ray(noise, lines)
    weights = np.broadcast_to(1.0 / noises**2, lines.shape).astype(np.float32)
    inside = Inside.of(projector, lines) if non_negative else Inside.all_of(projector)
    start = mean_along_rays(inside.projector, lines)
    typical = typical_attenuation(start)
    if weight is None:
        middle = len(lines) // 2
        tried = WEIGHTS / typical[middle]
        prior = _prior(np.full(tried.size, typical[middle]), tried)
        objective = Objective(inside.projector, lines[middle : middle + 1], weights[middle : middle + 1], prior)
        noise_here = np.broadcast_to(noises, lines.shape)[middle]
        weight = hold_out(objective, noise_here, start[middle], non_negative=non_negative).best(tried)
    strengths = np.full(typical.shape, weight)
    found = descend(
        Objective(projector, lines, weights, _prior(typical, strengths)),
        inside.whole(start),
        non_negative=non_negative,
        iterations=iterations,
        tolerance=tolerance,
        progress=progress,
    )
    images = found.images
    misfit = data_misfit(projector, images, lines, noises)
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


def _prior(typical: Floats, strengths: Floats) -> Prior:
    scale = SMOOTHING_SHARE * typical
    return Prior("total-variation", scale, strengths, typical)
