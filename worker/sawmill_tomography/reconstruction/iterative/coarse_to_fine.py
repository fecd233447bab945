"""Coarse to fine: a convex objective descends with large pixels first, then continues with its own.

Large pixels and wide detector cells cost a fourth at each level, and most of the way to the minimum is a matter of
large shapes. The position of the minimum does not change.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sawmill_tomography.geometry.geometry import GeometryError
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.iterative import descent
from sawmill_tomography.reconstruction.iterative.coupled import CoupledObjective, descend_coupled
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images, Minimum
from sawmill_tomography.reconstruction.iterative.penalised import (
    HalvedInverseCurvature,
    InverseCurvature,
    Objective,
    descend,
)
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, Phases

# The constants of this file were measured with benchmarks/slice_price.py.
# Iterations with pixels of four and of two times the size; large shapes that have not converged there do so slowly
# later.
ITERATIONS = (14, 40)
# Iterations with pixels of two times the size until they show directions across rings, and with these directions
# (benchmarks/tree_disc.py).
UNDIRECTED_ITERATIONS, DIRECTED_ITERATIONS = 24, 20
# Iterations with the own pixels and pairs of cells.
PAIRED_ITERATIONS = 6
# Tolerance of the levels before the last one.
COARSER_TOLERANCE = 1e-4
# Pairs of cells show as much as the pixels can hold if they are no wider than this number of pixels.
PAIR_PIXELS = 1.25
# The least weight of a ray before the last level, as a share of the mean weight in its view. Rays left out have
# estimated values: without these, pixels that no other ray crosses would fall to 0, and rise slowly.
LEAST_WEIGHT = 0.01
# Factor on the estimated inverse curvature in the first step from the mean along the rays, and from the image of the
# level before, whose differences are mostly edges: steps that are too long cost a projection each.
FROM_MEAN, FROM_LEVEL = 0.2, 0.05
# A size must be a multiple of this to be halved at every level.
MULTIPLE = 2 ** len(ITERATIONS)
# Fewer pixels across show no log.
LEAST_SIZE = 32
# A descent from the image of the level before starts near the minimum: this many small gains end the descent.
WINDOW = 2


@dataclass(frozen=True, eq=False)
class Level:
    """A level on the way to the minimum: an objective with larger pixels or wider cells, and its iterations."""

    objective: Objective
    iterations: int
    cost: float  # cost of an iteration, relative to one of the objective itself
    directed: bool = False  # True if the prior has directions, of the images of the level before


def descend_by_levels(
    objective: Objective,
    start: Images | None = None,
    *,
    non_negative: bool,
    iterations: int,
    tolerance: float,
    usual: int,
    coupling: Floats | None = None,
    on_progress: OnProgress | None = None,
) -> Minimum:
    """Minimise from a near image (images, n, n), or through larger pixels from the mean along the rays.

    `coupling` (images - 1,): coupling of neighbouring slices (`CoupledObjective`); by default the images are
    independent.
    """
    levels = [] if start is not None else coarser_levels(_with_every_ray(objective))
    names = [f"level {n}" for n in range(len(levels))]
    costs = {name: level.cost * level.iterations for name, level in zip(names, levels, strict=True)}
    phases = Phases(on_progress, **costs, last=usual)
    scale = FROM_LEVEL
    if start is None:
        scale, first = FROM_MEAN, levels[0].objective if levels else objective
        start = mean_along_rays(first.projector, first.lines)
    joined = np.zeros(len(start) - 1) if coupling is None else coupling
    directions: Images | None = None
    for name, level in zip(names, levels, strict=True):
        own = level.objective
        if level.directed:
            directions = _directions(objective, start, joined) if directions is None else directions
            own = _directed(own, directions)
        minimum = _descend(
            own,
            coupling,
            _on_grid_of(own, start),
            non_negative=non_negative,
            iterations=level.iterations,
            tolerance=COARSER_TOLERANCE,
            first_scale=scale,
            window=WINDOW,
            on_iteration=phases.descent(name, level.iterations),
        )
        start, scale = minimum.images, FROM_LEVEL
    if directions is None:
        directions = _directions(objective, start, joined)
    objective = _directed(objective, directions)
    start = _on_grid_of(objective, start)
    return _descend(
        objective,
        coupling,
        start,
        non_negative=non_negative,
        iterations=iterations,
        tolerance=tolerance,
        first_scale=scale,
        window=WINDOW if levels else descent.WINDOW,
        on_iteration=phases.descent("last", usual),
    )


def _descend(objective: Objective, coupling: Floats | None, start: Images, **settings: Any) -> Minimum:  # noqa: ANN401
    curvature = InverseCurvature if objective.projector.grid.size % 2 else HalvedInverseCurvature
    if coupling is None or not coupling.any():
        return descend(objective, start, **settings, preconditioner=curvature)
    return descend_coupled(CoupledObjective(objective, coupling), start, **settings, curvature=curvature(objective))


def _with_every_ray(objective: Objective) -> Objective:
    """Return the objective in which each ray has `LEAST_WEIGHT`, unless its whole view is left out."""
    weights = objective.weights
    return replace(objective, weights=np.maximum(weights, LEAST_WEIGHT * weights.mean(axis=-1, keepdims=True)))


def coarser_levels(objective: Objective) -> list[Level]:
    """Return the levels before an objective, the largest pixels first; none where they would have too few pixels."""
    levels, cost = list[Level](), 1.0
    if _can_be_halved(objective) and has_narrow_cells(objective):
        objective = with_pairs_of_cells(objective)
        cost *= 0.5
        levels.insert(0, Level(objective, PAIRED_ITERATIONS, cost, directed=True))
    for iterations in reversed(ITERATIONS):
        if not _can_be_halved(objective):
            break
        objective = coarser(objective)
        cost *= 0.25
        if objective.prior.has_directions and iterations == ITERATIONS[-1]:
            levels.insert(0, Level(objective, DIRECTED_ITERATIONS, cost, directed=True))
            levels.insert(0, Level(objective, UNDIRECTED_ITERATIONS, cost))
        else:
            levels.insert(0, Level(objective, iterations, cost))
    return levels


def _can_be_halved(objective: Objective) -> bool:
    size = objective.projector.grid.size
    return size % 2 == 0 and size // 2 >= LEAST_SIZE


def has_narrow_cells(objective: Objective) -> bool:
    """Return True if pairs of cells show as much as the pixels can hold."""
    geometry = objective.projector.geometry
    pair_mm = 2.0 * geometry.cell_at_cor_mm
    return geometry.sinogram_shape[1] % 2 == 0 and pair_mm <= PAIR_PIXELS * objective.projector.grid.pixel_mm


def coarser(objective: Objective) -> Objective:
    """Return the objective with pixels of twice the size, and with cells in pairs where their number is even."""
    if objective.projector.geometry.sinogram_shape[1] % 2 == 0:
        objective = with_pairs_of_cells(objective)
    projector, grid, prior = objective.projector, objective.projector.grid, objective.prior
    return replace(
        objective,
        projector=Projector(projector.geometry, ImageGrid(grid.size // 2, grid.field_mm, grid.centre_mm)),
        # An edge passes half the number of pixels.
        prior=replace(prior, strength=2.0 * prior.strength),
    )


def with_pairs_of_cells(objective: Objective) -> Objective:
    """Return the objective with detector cells in pairs: the weighted mean of the lines, and the sum of the weights."""
    projector = Projector(objective.projector.geometry.in_pairs(), objective.projector.grid)
    lines = objective.lines
    weights = np.broadcast_to(objective.weights, np.broadcast_shapes(objective.weights.shape, lines.shape))
    total = weights[..., ::2] + weights[..., 1::2]
    both = lines[..., ::2] * weights[..., ::2] + lines[..., 1::2] * weights[..., 1::2]
    mean = np.divide(both, total, out=np.zeros_like(both), where=total > 0.0)
    return replace(objective, projector=projector, lines=mean, weights=total)


def _directions(objective: Objective, images: Images, joined: Floats) -> Images | None:
    """Return the directions that images on the objective's field show to its prior."""
    grid = objective.projector.grid
    return objective.prior.directions_of(images, ImageGrid(images.shape[1], grid.field_mm, grid.centre_mm), joined)


def _directed(objective: Objective, directions: Images | None) -> Objective:
    """Return the objective with the directions in its prior."""
    return replace(objective, prior=objective.prior.directed(directions, objective.projector.grid.size))


def _on_grid_of(objective: Objective, images: Images) -> Images:
    """Return the images, with pixels of half the size where the objective has these."""
    return images if images.shape[1] == objective.projector.grid.size else finer(images)


def finer(images: Images) -> Images:
    """Interpolate images (images, n, n) linearly to pixels of half the size, (images, 2 n, 2 n)."""
    for axis in (1, 2):
        n = images.shape[axis]
        padded = np.take(images, np.clip(np.arange(-1, n + 1), 0, n - 1), axis=axis)
        here, before, after = (np.take(padded, np.arange(first, first + n), axis=axis) for first in (1, 0, 2))
        shape = list(images.shape)
        shape[axis] *= 2
        images = np.stack([0.75 * here + 0.25 * before, 0.75 * here + 0.25 * after], axis=axis + 1).reshape(shape)
    return images


def mean_along_rays(projector: Projector, lines: Images) -> Images:
    """Compute a first image: each pixel is the mean, weighted by length, of the mean attenuation along its rays.

    (slices, views, detector) -> (slices, n, n), in attenuation; 0 where no ray passes.
    """
    lengths = projector.forward(np.ones((projector.grid.size, projector.grid.size), np.float32))
    crossed = projector.adjoint(np.ones_like(lengths))
    image: Images = projector.adjoint(np.divide(lines, lengths, out=np.zeros_like(lines), where=lengths > 0.0))
    return np.divide(image, crossed, out=np.zeros_like(image), where=crossed > 0.0)


def typical_attenuation(images: Images) -> Floats:
    """Return the mass-weighted mean attenuation of each slice, sum x^2 / sum x, (slices,), from `mean_along_rays`."""
    body = np.maximum(images, 0.0).astype(np.float64)
    mass = body.sum(axis=(1, 2))
    if not (mass > 0.0).all():
        raise GeometryError("a slice has no attenuation anywhere, so its scale cannot be chosen: leave it out")
    return np.asarray(np.square(body).sum(axis=(1, 2)) / mass)
