"""The share of contrast that a knot keeps in an image: known inserts are added to a slice's data and reconstructed."""

import math
from typing import Any

import numpy as np

from sawmill_tomography.geometry.contrast_loss import AROUND, KNOT_MM
from sawmill_tomography.geometry.geometry import TAU, FloatArray
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import (
    MULTIPLE,
    coarser,
    descend_by_levels,
    finer,
    has_narrow_cells,
    mean_along_rays,
    typical_attenuation,
    with_pairs_of_cells,
)
from sawmill_tomography.reconstruction.iterative.edge_preserving import PriorProblem
from sawmill_tomography.reconstruction.iterative.penalised import Objective, weights_of
from sawmill_tomography.reconstruction.iterative.ring_directions import outlines
from sawmill_tomography.reconstruction.total_variation import ITERATIONS, TotalVariation
from sawmill_tomography.reconstruction.total_variation_weights import TOLERANCE

# Diameters of the inserts, and their attenuation above the wood's, in the wood's typical attenuation: a knot is 15 to
# 45 % denser.
DIAMETERS_MM, DENSER = (KNOT_MM, 20.0), 0.3
# Inserts of each diameter, on a circle of this share of the log's radius; a smaller log has no room for them.
INSERTS, CIRCLE, LEAST_RADIUS_MM = 4, 0.5, 60.0
# Larger pixels show no knot of 10 mm.
LARGEST_PIXEL_MM = 3.2
# Size of the pixels that show the outline, in own pixels.
OUTLINE_PIXEL = 4
# Iterations with pixels of twice the size, and then with the own pixels. They differ from a converged descent by less
# than 10 % from 20 views on; at 12 views, as much as another place of the inserts (CT slice of docs/understand/wood.md,
# simulated logs, 0.5 and 2 % noise).
LARGER_ITERATIONS, OWN_ITERATIONS = 8, 4


def knot_contrasts(
    projector: Projector, lines: Image, method: TotalVariation, *, noise: FloatArray
) -> dict[float, float] | None:
    """Return the share of contrast that an insert of each of `DIAMETERS_MM` keeps, by its diameter.

    Parameters
    ----------
    projector : Projector
    lines : (views, detector) float32
        Line integrals of a slice, whose air is at 0.
    method : TotalVariation
        Method with its weights chosen.
    noise : float64, broadcasts with (1, views, detector)
        Standard deviation of each line integral.

    Returns
    -------
    dict of float to float, or None
        None where the log is too small, or the pixels too large, for the inserts.
    """
    grid = projector.grid
    if grid.pixel_mm > LARGEST_PIXEL_MM:
        return None
    large = ImageGrid(max(grid.size // OUTLINE_PIXEL, 1), grid.field_mm, grid.centre_mm)
    first = mean_along_rays(Projector(projector.geometry, large), lines[None])
    typical = typical_attenuation(first)
    (centre,), (radius,), _ = outlines(first / np.float32(typical[0]), large)
    if radius < LEAST_RADIUS_MM:
        return None
    density = DENSER * float(typical[0])
    distances = {diameter: _distances(grid, centre, CIRCLE * radius, n) for n, diameter in enumerate(DIAMETERS_MM)}
    inserts = sum(
        np.clip((0.5 * diameter - away) / grid.pixel_mm + 0.5, 0.0, 1.0) for diameter, away in distances.items()
    )
    both = np.stack([lines, lines + projector.forward(density * np.asarray(inserts, np.float32))])
    problem = PriorProblem.of(projector, both, noise, non_negative=method.non_negative, multiple=MULTIPLE)
    images = _images_near_the_minimum(problem, method.alone)
    change = (images[1] - images[0]) / density
    return {diameter: _contrast(change, away / (0.5 * diameter)) for diameter, away in distances.items()}


def _images_near_the_minimum(problem: PriorProblem, method: TotalVariation) -> Image:
    """Return both slices' images (2, size, size), whose own pixels follow few iterations with larger ones."""
    weights, prior = weights_of(problem.noises, problem.lines.shape), method.prior(problem.typical_attenuation)
    objective = Objective(problem.support.projector, problem.lines, weights, prior)
    start, iterations = None, ITERATIONS
    settings: dict[str, Any] = {"non_negative": method.non_negative, "tolerance": TOLERANCE, "usual": OWN_ITERATIONS}
    if objective.projector.grid.size % 2 == 0:
        larger = descend_by_levels(coarser(objective), iterations=LARGER_ITERATIONS, **settings)
        start, iterations = finer(larger.images), OWN_ITERATIONS
    if has_narrow_cells(objective):
        objective = with_pairs_of_cells(objective)
    return problem.support.embedded(descend_by_levels(objective, start, iterations=iterations, **settings).images)


def _distances(grid: ImageGrid, centre: FloatArray, circle_mm: float, place: int) -> FloatArray:
    """Return each pixel's distance in mm from the nearest insert of one diameter, (size, size)."""
    middles = (np.arange(grid.size) + 0.5) * grid.pixel_mm
    x, y = grid.low_mm[0] + middles[:, None] - centre[0], grid.low_mm[1] + middles - centre[1]
    angles = (np.arange(INSERTS) + 0.3 + place / len(DIAMETERS_MM)) * TAU / INSERTS
    away = [(x - circle_mm * math.cos(angle)) ** 2 + (y - circle_mm * math.sin(angle)) ** 2 for angle in angles]
    return np.asarray(np.sqrt(np.min(away, axis=0)))


def _contrast(change: Image, relative: FloatArray) -> float:
    """Return the change in the inserts less the one around them, from each pixel's distance in insert radii."""
    return float(change[relative < 1.0].mean() - change[(relative > AROUND[0]) & (relative < AROUND[1])].mean())
