"""Coarse to fine: a convex objective descends with large pixels first, and from there with its own.

Large pixels and wide detector cells cost a fourth at each level, and most of the way to the minimum is a matter of
large shapes. Where the minimum lies does not depend on it.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from sawmill_worker.tomography.geometry import FanBeamGeometry, Scanner
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.iterative.coupled import CoupledObjective, descend_coupled
from sawmill_worker.tomography.iterative.descent import Floats, Images, Minimum
from sawmill_worker.tomography.iterative.first_image import mean_along_rays
from sawmill_worker.tomography.iterative.penalised import Objective, descend
from sawmill_worker.tomography.iterative.progress import OnProgress, Phases
from sawmill_worker.tomography.projector import Projector

# The constants of this file were measured with benchmarks/slice_price.py.
# Iterations with pixels of four and of two times the size; from there few more are gained than the next level gains.
ITERATIONS = (14, 10)
# Sizes that can be halved so often.
MULTIPLE = 2 ** len(ITERATIONS)
# Fewer pixels across show no log.
LEAST_SIZE = 32
# The cost of an iteration relative to that of the next level.
COARSER_COST = 0.25
# An iteration with the own pixels begins near the minimum: this many that gain too little end the descent.
WINDOW = 4


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
    """Minimise from a near image (images, n, n), or by way of larger pixels from the mean along the rays.

    Parameters
    ----------
    iterations, tolerance
        Of the last level.
    usual : int
        Iterations of the last level after which most logs have converged.
    coupling : (images - 1,) float64, optional
        As of `CoupledObjective`, of neighbouring slices; by default each image is by itself.
    on_progress : callable, optional
        Called with the share of the work that is done.
    """
    coarser = [] if start is not None else _coarser_levels(objective)
    costs = {f"level {n}": COARSER_COST**n * ITERATIONS[-n] for n in range(len(coarser), 0, -1)}
    phases = Phases(on_progress, **costs, last=usual)
    if start is None:
        first = coarser[0] if coarser else objective
        start = mean_along_rays(first.projector, first.lines)
    for n, level in zip(range(len(coarser), 0, -1), coarser, strict=True):
        found = _descend(
            level,
            coupling,
            start,
            non_negative=non_negative,
            iterations=ITERATIONS[-n],
            tolerance=tolerance,
            on_iteration=phases.descent(f"level {n}", ITERATIONS[-n]),
        )
        start = finer(found.images)
    return _descend(
        objective,
        coupling,
        start,
        non_negative=non_negative,
        iterations=iterations,
        tolerance=tolerance,
        on_iteration=phases.descent("last", usual),
    )


def _descend(objective: Objective, coupling: Floats | None, start: Images, **settings: Any) -> Minimum:  # noqa: ANN401
    if coupling is None or not coupling.any():
        return descend(objective, start, **settings, window=WINDOW)
    return descend_coupled(CoupledObjective(objective, coupling), start, **settings, window=WINDOW)


def _coarser_levels(objective: Objective) -> list[Objective]:
    """The objective with larger pixels, the largest first."""
    levels = list[Objective]()
    while len(levels) < len(ITERATIONS):
        size = objective.projector.grid.size
        if size % 2 or size // 2 < LEAST_SIZE:
            break
        objective = coarser(objective)
        levels.insert(0, objective)
    return levels


def coarser(objective: Objective) -> Objective:
    """The objective with pixels of twice the size, and pairs of detector cells as one where their number is even."""
    projector = objective.projector
    geometry, grid = projector.geometry, projector.grid
    lines, weights = objective.lines, objective.weights
    scanner = geometry.scanner
    if scanner.num_detector_pixels % 2 == 0:
        wide = Scanner(scanner.source_to_cor_mm, scanner.num_detector_pixels // 2, 2.0 * scanner.detector_pitch_mm)
        geometry = FanBeamGeometry(wide, geometry.theta, geometry.angles_rad)
        lines, weights = _paired(lines, weights)
    return Objective(
        Projector(geometry, ImageGrid(grid.size // 2, grid.field_mm, grid.centre_mm)),
        lines,
        weights,
        # An edge passes half as many pixels.
        replace(objective.prior, strength=2.0 * objective.prior.strength),
    )


def finer(images: Images) -> Images:
    """Images (images, n, n) with pixels of half the size, (images, 2 n, 2 n), interpolated linearly."""
    for axis in (1, 2):
        n = images.shape[axis]
        padded = np.take(images, np.clip(np.arange(-1, n + 1), 0, n - 1), axis=axis)
        here, before, after = (np.take(padded, np.arange(first, first + n), axis=axis) for first in (1, 0, 2))
        both = np.stack([0.75 * here + 0.25 * before, 0.75 * here + 0.25 * after], axis=axis + 1)
        shape = list(images.shape)
        shape[axis] *= 2
        images = both.reshape(shape)
    return images


def _paired(lines: Images, weights: Images) -> tuple[Images, Images]:
    """Lines and weights of pairs of cells: the weighted mean, and the sum."""
    weights = np.broadcast_to(weights, np.broadcast_shapes(weights.shape, lines.shape))
    total = weights[..., ::2] + weights[..., 1::2]
    both = lines[..., ::2] * weights[..., ::2] + lines[..., 1::2] * weights[..., 1::2]
    return np.divide(both, total, out=np.zeros_like(both), where=total > 0.0), total
