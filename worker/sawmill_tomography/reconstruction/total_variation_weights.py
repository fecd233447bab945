"""The weights of total variation, in the plane and along the axis: chosen from the data by cross-validation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import MULTIPLE, descend_by_levels
from sawmill_tomography.reconstruction.iterative.cross_validation import (
    cross_validate,
    first_images_of_folds,
    parabola_minimum,
    power_along_detector,
)
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images
from sawmill_tomography.reconstruction.iterative.edge_preserving import PriorProblem
from sawmill_tomography.reconstruction.iterative.penalised import Objective, weights_of
from sawmill_tomography.reconstruction.iterative.priors import RingPrior, TotalVariationPrior
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, Phases
from sawmill_tomography.reconstruction.iterative.ring_directions import edge_directions, halved, ring_directions

# Differences below this share of the wood's attenuation are smoothed quadratically. This and the constants below were
# found on simulated logs (benchmarks/choosing.py).
SMOOTHING_SHARE = 0.02
# Candidates for the weight, times the typical attenuation: the penalty of a difference as large as the wood.
WEIGHTS = np.geomspace(1.35, 60.0, 5)
# Ratio of the weight to the one of the best prediction. With the validation data included again the data weigh more,
# and an image is nearest to its log if it is somewhat smoother than the one that predicts views best.
SMOOTHER = 1.55
CANDIDATE_ITERATIONS = 8
# The cost of the folds' first images relative to the candidates' cost.
FIRST_IMAGES_COST = 0.25
# This ends within 3 % of the converged error, in the mean of sixteen logs, from 20 views on
# (benchmarks/slice_price.py).
TOLERANCE = 5e-3
# Iterations with the own pixels after which most logs have converged (benchmarks/slice_price.py).
USUAL_ITERATIONS = 4
# Candidates for the coupling, each with the ratio of the weight in the plane to the uncoupled weight: coupled slices
# need a smaller weight in the plane. Found on simulated logs with known truth (seeds from 4000 of
# benchmarks/whole_logs.py). With rings of real wood, ratios 0.8 times as large have 1 to 2 % less error at 2 % noise,
# and as much more at 0.5 %.
COUPLINGS = ((0.0, 1.0), (0.2, 0.85), (0.4, 0.75), (0.7, 0.65))
# Candidates for the weight across rings, each with ratios of the weight to the one of total variation
# (benchmarks/tree_disc.py).
RING_CANDIDATES = ((1.0, (1.0,)), (0.1, (1.5,)), (0.03, (0.7, 1.4, 2.8)), (0.01, (2.0,)))
# Rings are taken where they predict better than a mean of two without: directions along edges alone count by this
# share, total variation by the rest. From 0.71 to 0.87 none of 170 boards, discs and L shapes gets rings
# (benchmarks/ring_choice.py). A least gain over total variation gave rings to 18 of them, and none to 19 of 49 scans of
# the CT slice, the published log and six simulated logs: now to 8, seven of them from 12 views.
EDGES_SHARE = 0.75
VALIDATION_VIEWS = 4
# Limit of the iterations with the own pixels.
COUPLING_ITERATIONS = 10


@dataclass(frozen=True, eq=False)
class WeightChoice:
    """The weight for one slice, and the weight across rings."""

    weight: float
    ring_weight: float
    images: Image  # (folds, size, size) float32

    @property
    def image(self) -> Image:
        """Image near the slice's image, (size, size)."""
        return np.asarray(self.images.mean(axis=0))


def choose_weight(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    on_progress: OnProgress | None = None,
) -> WeightChoice:
    """Choose the weight of `total_variation` for a sinogram (views, detector), by cross-validation.

    Parameters are documented in `total_variation`, here for one sinogram.
    """
    return _chosen_weight(PriorProblem.of(projector, sinogram, noise, non_negative=non_negative), on_progress)


def _chosen_weight(problem: PriorProblem, on_progress: OnProgress | None) -> WeightChoice:
    """Choose the weight for a problem of one slice."""
    lines, noises, support, non_negative = problem.lines, problem.noises, problem.support, problem.non_negative
    typical = problem.typical_attenuation
    candidates = WEIGHTS / typical
    prior = smoothed_prior(np.broadcast_to(typical, candidates.shape), candidates)
    objective = Objective(support.projector, lines, weights_of(noises, lines.shape), prior)
    phases = Phases(on_progress, first_images=FIRST_IMAGES_COST, candidates=1.0)
    # Continuation leads to much the same image for all candidates: they all use the middle one's.
    validation = cross_validate(
        objective,
        noises[0],
        first_images_of_folds(
            objective.only(candidates.size // 2),
            problem.first_images[0],
            non_negative=non_negative,
            on_progress=phases.of("first_images"),
        ),
        exponent=1.0,
        iterations=CANDIDATE_ITERATIONS,
        non_negative=non_negative,
        on_progress=phases.of("candidates"),
    )
    errors = np.log(validation.in_views) + np.log(validation.in_rays)
    weight, _ = parabola_minimum(candidates, errors)
    return WeightChoice(SMOOTHER * weight, 1.0, support.embedded(validation.images[:, np.argmin(errors)]))


def choose_ring_weight(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    weight: float | None = None,
    ring_weight: float | None = None,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    on_progress: OnProgress | None = None,
) -> WeightChoice:
    """Choose the weight across rings of `total_variation`, and the weight for it, by cross-validation.

    The images of total variation without the validation data show the directions.

    Parameters are documented in `total_variation`, here for one sinogram; a weight that is given is kept.
    """
    problem = PriorProblem.of(projector, sinogram, noise, non_negative=non_negative)
    support, typical = problem.support, problem.typical_attenuation
    phases = Phases(on_progress, first=1.0, rings=1.0, edges=0.2)
    isotropic = _chosen_weight(problem, phases.of("first"))
    if ring_weight == 1.0:
        return isotropic
    starts = np.ascontiguousarray(isotropic.images[:, *support.part])
    grid, mean = support.projector.grid, starts.mean(axis=0, keepdims=True)
    if grid.size % 2 == 0:
        mean = halved(mean)
    mean_grid = ImageGrid(mean.shape[1], grid.field_mm, grid.centre_mm)
    base = isotropic.weight / SMOOTHER
    candidates = [
        (ring, base * ratio if weight is None else weight / SMOOTHER)
        for ring, ratios in (RING_CANDIDATES if ring_weight is None else ((ring_weight, RING_CANDIDATES[2][1]),))
        for ratio in (ratios if weight is None else (1.0,))
    ]
    rings, weights = (np.array(column) for column in zip(*candidates, strict=True))
    data_weights = weights_of(problem.noises, problem.lines.shape)

    def validate(which: slice, directions: Images, phase: str) -> tuple[Floats, Images]:
        """Return the candidates' errors, and their images (folds, candidates, n, n)."""
        prior = smoothed_prior(np.broadcast_to(typical, weights[which].shape), weights[which], rings[which])
        validation = cross_validate(
            Objective(support.projector, problem.lines, data_weights, prior.directed(directions, grid.size)),
            problem.noises[0],
            starts,
            exponent=1.0,
            iterations=CANDIDATE_ITERATIONS,
            non_negative=non_negative,
            on_progress=phases.of(phase),
        )
        return np.log(validation.in_views) + np.log(validation.in_rays), validation.images

    errors, images = validate(slice(None), ring_directions(mean, mean_grid, typical, np.zeros(0)), "rings")
    best = int(np.argmin(np.where(rings < 1.0, errors, np.inf)))
    if ring_weight is None:
        (by_edges,), _ = validate(slice(best, best + 1), edge_directions(mean, mean_grid, typical), "edges")
        if errors[best] >= EDGES_SHARE * by_edges + (1.0 - EDGES_SHARE) * errors[0]:
            return isotropic if weight is None else WeightChoice(weight, 1.0, support.embedded(images[:, 0]))
    same = rings == rings[best]
    chosen, _ = parabola_minimum(weights[same], errors[same])
    return WeightChoice(SMOOTHER * chosen, float(rings[best]), support.embedded(images[:, best]))


@dataclass(frozen=True)
class CouplingChoice:
    """The coupling of neighbouring slices, and the weight in the plane for this coupling."""

    coupling: float
    weight: float


def choose_coupling(
    projector: Projector,
    lines: Image,
    weight: float,
    *,
    ring_weight: float = 1.0,
    numbers: NDArray[np.int64] | None = None,
    weight_stays: bool = False,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    on_progress: OnProgress | None = None,
) -> CouplingChoice:
    """Choose the coupling of slices (slices, views, detector), by cross-validation over views of all slices.

    Every VALIDATION_VIEWS-th view is left out of all slices; the candidate whose images predict these views best is
    chosen, 0 among them. Only the slices with most neighbours count. The result is 0 where no slice has a neighbour.

    `numbers` (slices,) int64: parameter of `TotalVariation.reconstruct`.
    """
    neighbours = axial_neighbours(len(lines), numbers)
    if not neighbours.any():
        return CouplingChoice(0.0, weight)
    number_of_neighbours = np.append(neighbours, 0.0) + np.append(0.0, neighbours)
    judged = number_of_neighbours == number_of_neighbours.max()
    problem = PriorProblem.of(projector, lines, noise, non_negative=non_negative, multiple=MULTIPLE)
    noises = np.broadcast_to(problem.noises, problem.lines.shape)
    views = np.arange(lines.shape[1]) % VALIDATION_VIEWS == VALIDATION_VIEWS // 2
    training = weights_of(np.where(views[:, None], np.inf, noises), noises.shape)
    typical = problem.typical_attenuation
    weights = {coupling: weight if weight_stays else factor * weight for coupling, factor in COUPLINGS}
    phases = Phases(on_progress, **{f"{coupling:g}": 1.0 for coupling in weights})

    def error(coupling: float) -> float:
        prior = smoothed_prior(typical, np.full(len(lines), weights[coupling]), np.full(len(lines), ring_weight))
        minimum = descend_by_levels(
            Objective(problem.support.projector, problem.lines, training, prior),
            non_negative=non_negative,
            iterations=COUPLING_ITERATIONS,
            tolerance=TOLERANCE,
            usual=USUAL_ITERATIONS,
            coupling=coupling * neighbours,
            on_progress=phases.of(f"{coupling:g}"),
        )
        missed = (problem.support.projector.forward(minimum.images[judged]) - problem.lines[judged]) / noises[judged]
        return float(np.log(power_along_detector(missed[:, views], 1.0)).sum())

    errors = {coupling: error(coupling) for coupling in weights}
    best = min(errors, key=lambda coupling: errors[coupling])
    return CouplingChoice(best, weights[best])


def axial_neighbours(slices: int, numbers: NDArray[np.int64] | None) -> Floats:
    """Return 1 between slices that follow each other along the log, else 0; (slices - 1,)."""
    return np.ones(max(slices - 1, 0)) if numbers is None else (np.diff(numbers) == 1).astype(np.float64)


def weight_factor(coupling: float) -> float:
    """Return the ratio of the weight in the plane to the uncoupled weight."""
    couplings, factors = zip(*COUPLINGS, strict=True)
    return float(np.interp(coupling, couplings, factors))


def smoothed_prior(typical: Floats, weights: Floats, ring_weights: Floats | None = None) -> TotalVariationPrior:
    """Return the prior for images of these typical attenuations, (images,); ring-aware where a weight is not 1."""
    scale = SMOOTHING_SHARE * typical
    if ring_weights is None or (ring_weights == 1.0).all():
        return TotalVariationPrior(scale, weights, typical)
    return RingPrior(scale, weights, typical, 1.0 - ring_weights)
