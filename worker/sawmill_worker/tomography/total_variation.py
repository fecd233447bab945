"""Smoothed total variation: convex, and the yardstick for other edge-preserving methods."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_worker.tomography.estimate import Estimate
from sawmill_worker.tomography.geometry import GeometryError
from sawmill_worker.tomography.iterative.coarse_to_fine import MULTIPLE, descend_by_levels
from sawmill_worker.tomography.iterative.cross_validation import (
    cross_validate,
    first_images_of_folds,
    parabola_minimum,
    power_along_detector,
)
from sawmill_worker.tomography.iterative.descent import Floats
from sawmill_worker.tomography.iterative.edge_preserving import (
    EdgePreservingMethod,
    Problem,
    Settings,
    reconstruct_with_prior,
)
from sawmill_worker.tomography.iterative.first_image import typical_attenuation
from sawmill_worker.tomography.iterative.penalised import Objective
from sawmill_worker.tomography.iterative.priors import TotalVariationPrior
from sawmill_worker.tomography.iterative.progress import OnProgress, Phases
from sawmill_worker.tomography.method import CANDIDATES_AT_ONCE, IMAGES_OF_A_DESCENT, CoupledMethod, LeftOut
from sawmill_worker.tomography.noise import noise_of_rays
from sawmill_worker.tomography.projector import Image, Projector

# Differences below this share of the wood's attenuation are smoothed quadratically. This and the numbers below were
# found on simulated logs (benchmarks/choosing.py).
SMOOTHING_SHARE = 0.02
# Candidates for the weight, times the typical attenuation: the penalty of a difference as large as the wood.
WEIGHTS = np.geomspace(1.35, 60.0, 5)
# The weight taken over the one of the best prediction. With the validation data included again the data weigh more, and
# an image is nearest to its log where it is somewhat smoother than the one that predicts views best.
SMOOTHER = 1.55
CANDIDATE_ITERATIONS = 8
# The cost of the folds' first images relative to that of the candidates.
FIRST_IMAGES_COST = 0.25
ITERATIONS = 300
# Ends within 3 % of the error at rest, in the mean of sixteen logs, from 20 views on (benchmarks/slice_price.py).
TOLERANCE = 3e-3
# Iterations with the own pixels after which most logs have converged (benchmarks/slice_price.py).
USUAL_ITERATIONS = 10
# Projections forward and back: 12 with the own pixels, and what those with larger ones are worth.
USUAL_PAIRS = 17.0
# Candidates for the coupling, and what the weight in the plane is times the uncoupled one with each: slices that help
# each other need less in the plane. Found on simulated logs with the truth in hand (seeds from 4000 of
# benchmarks/whole_logs.py).
COUPLINGS = ((0.0, 1.0), (0.2, 0.85), (0.4, 0.75), (0.7, 0.65))
VALIDATION_VIEWS = 4
# What lies further away changes a slice by less than the noise does.
HALO = 2
# The cost of choosing the weight, in iterations on one slice of 256 x 256 pixels from 20 views
# (benchmarks/choosing.py).
CHOOSING_COST = 210.0


def total_variation(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    weight: float | None = None,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    coupling: ArrayLike = 0.0,
    on_progress: OnProgress | None = None,
) -> Estimate:
    """Reconstruct one slice or a block of slices by penalising the sum of differences (Rudin, Osher and Fatemi 1992).

    The objective is 1/2 sum ((A x - y) / noise)^2 + weight * sum (sqrt(|d|^2 + s^2) - s). The estimate's parameter is
    `weight`, (slices,).

    Coupled, weight * coupling * sum (sqrt(d^2 + s^2) - s) of the differences along the axis comes on top.

    Parameters
    ----------
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air stands at 0.
    weight : float, optional
        In 1 / attenuation; by default chosen from the middle slice by cross-validation.
    coupling : float or (slices - 1,) float
        Of each slice with the next one, 0 or more; 0 where they are no neighbours.
    noise, non_negative, iterations, tolerance, on_progress
        As of `cauchy_map`.

    Raises
    ------
    GeometryError
        If shapes do not fit, a value is not positive, or a slice is 0 in every ray.
    """
    if weight is not None and not (np.isfinite(weight) and weight > 0.0):
        raise GeometryError(f"weight must be a positive number in 1 / attenuation, not {weight}")

    problem = Problem.of(projector, sinogram, noise, non_negative=non_negative, multiple=MULTIPLE)
    couplings, slices = np.asarray(coupling, np.float64), len(problem.lines)
    if couplings.shape not in {(), (slices - 1,)}:
        raise GeometryError(
            f"coupling must be one number, or {slices - 1} of them for {slices} slices, not of shape {couplings.shape}"
        )
    if not ((couplings >= 0.0).all() and np.isfinite(couplings).all()):
        raise GeometryError(f"coupling must be 0 or a positive number, not {couplings.min():g}")
    between = np.broadcast_to(couplings, slices - 1)
    strongest = float(between.max(initial=0.0))

    def settings(problem: Problem, choice: WeightChoice | None) -> Settings:
        typical = typical_attenuation(problem.first_images)
        weights = np.full(typical.shape, weight if choice is None else _weight_factor(strongest) * choice.weight)
        parameters = {"weight": weights, "coupling": np.array([strongest])}
        return Settings(problem.noises, _prior(typical, weights), parameters, between)

    method = EdgePreservingMethod(
        choose=partial(choose_weight, non_negative=non_negative) if weight is None else None,
        settings=settings,
        choosing_cost=CHOOSING_COST,
        usual_iterations=USUAL_ITERATIONS,
        convex=True,
    )
    return reconstruct_with_prior(method, problem, iterations=iterations, tolerance=tolerance, on_progress=on_progress)


@dataclass(frozen=True, eq=False)
class WeightChoice:
    """The weight for one slice.

    Attributes
    ----------
    weight : float
    images : (folds, size, size) float32
        Near to its images without the validation data of each fold.
    """

    weight: float
    images: Image

    @property
    def image(self) -> Image:
        """Near to its image, (size, size)."""
        mean: Image = self.images.mean(axis=0)
        return mean


def choose_weight(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    on_progress: OnProgress | None = None,
) -> WeightChoice:
    """The weight that `total_variation` chooses for a sinogram (views, detector), by cross-validation.

    Parameters as of `total_variation`, for one sinogram.
    """
    problem = Problem.of(projector, sinogram, noise, non_negative=non_negative)
    lines, noises, support = problem.lines, problem.noises, problem.support
    typical = typical_attenuation(problem.first_images)
    candidates = WEIGHTS / typical
    weights = np.broadcast_to(1.0 / noises**2, lines.shape).astype(np.float32)
    prior = _prior(np.broadcast_to(typical, candidates.shape), candidates)
    objective = Objective(support.projector, lines, weights, prior)
    phases = Phases(on_progress, first_images=FIRST_IMAGES_COST, candidates=1.0)
    # Continuation leads to much the same image for all candidates: that of the middle one serves them.
    starts = first_images_of_folds(
        objective.only(candidates.size // 2),
        problem.first_images[0],
        non_negative=non_negative,
        on_progress=phases.of("first_images"),
    )
    validation = cross_validate(
        objective,
        noises[0],
        starts,
        exponent=1.0,
        iterations=CANDIDATE_ITERATIONS,
        non_negative=non_negative,
        on_progress=phases.of("candidates"),
    )
    errors = np.log(validation.in_views) + np.log(validation.in_rays)
    weight, _ = parabola_minimum(candidates, errors)
    return WeightChoice(SMOOTHER * weight, support.embedded(validation.images[:, np.argmin(errors)]))


@dataclass(frozen=True)
class CouplingChoice:
    """How much neighbouring slices help each other, and the weight in the plane that goes with it."""

    coupling: float
    weight: float


def choose_coupling(
    projector: Projector,
    lines: Image,
    weight: float,
    *,
    numbers: NDArray[np.int64] | None = None,
    weight_stays: bool = False,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    on_progress: OnProgress | None = None,
) -> CouplingChoice:
    """The coupling of slices (slices, views, detector), by cross-validation over views of all of them.

    Every VALIDATION_VIEWS-th view is left out of all slices; the candidate whose images predict these views best wins,
    0 among them. The slices with most neighbours count. 0 where no slice has any.

    Parameters
    ----------
    weight : float
        Of slices that are not coupled.
    numbers : (slices,) int64, optional
        As of `TotalVariation.reconstruct`.
    weight_stays : bool
        Whether the weight is the same with every coupling; by default it falls as the coupling rises.
    noise, non_negative, on_progress
        As of `total_variation`.
    """
    neighbours = _neighbours(len(lines), numbers)
    if not neighbours.any():
        return CouplingChoice(0.0, weight)
    number_of_neighbours = np.append(neighbours, 0.0) + np.append(0.0, neighbours)
    judged = number_of_neighbours == number_of_neighbours.max()
    problem = Problem.of(projector, lines, noise, non_negative=non_negative, multiple=MULTIPLE)
    noises = np.broadcast_to(problem.noises, problem.lines.shape)
    views = np.arange(lines.shape[1]) % VALIDATION_VIEWS == VALIDATION_VIEWS // 2
    training = np.where(views[:, None], 0.0, 1.0 / noises**2).astype(np.float32)
    typical = typical_attenuation(problem.first_images)
    weights = {coupling: weight if weight_stays else factor * weight for coupling, factor in COUPLINGS}
    phases = Phases(on_progress, **{f"{coupling:g}": 1.0 for coupling in weights})

    def error(coupling: float) -> float:
        prior = _prior(typical, np.full(len(lines), weights[coupling]))
        objective = Objective(problem.support.projector, problem.lines, training, prior)
        found = descend_by_levels(
            objective,
            non_negative=non_negative,
            iterations=USUAL_ITERATIONS,
            tolerance=TOLERANCE,
            usual=USUAL_ITERATIONS,
            coupling=coupling * neighbours,
            on_progress=phases.of(f"{coupling:g}"),
        )
        missed = (problem.support.projector.forward(found.images[judged]) - problem.lines[judged]) / noises[judged]
        return float(np.log(power_along_detector(missed[:, views], 1.0)).sum())

    errors = {coupling: error(coupling) for coupling in weights}
    best = min(errors, key=lambda coupling: errors[coupling])
    return CouplingChoice(best, weights[best])


def _neighbours(slices: int, numbers: NDArray[np.int64] | None) -> Floats:
    """1 between slices that follow each other along the log, 0 between others; (slices - 1,)."""
    return np.ones(max(slices - 1, 0)) if numbers is None else (np.diff(numbers) == 1).astype(np.float64)


def _weight_factor(coupling: float) -> float:
    """What the weight in the plane is times the uncoupled one."""
    couplings, factors = zip(*COUPLINGS, strict=True)
    return float(np.interp(coupling, couplings, factors))


def _prior(typical: Floats, weights: Floats) -> TotalVariationPrior:
    return TotalVariationPrior(SMOOTHING_SHARE * typical, weights, typical)


@dataclass(frozen=True)
class TotalVariation(CoupledMethod):
    """`total_variation` as a method of the table."""

    least_images: ClassVar[int] = IMAGES_OF_A_DESCENT * CANDIDATES_AT_ONCE
    pairs_a_slice: ClassVar[float] = USUAL_PAIRS
    choosing_cost_slices: ClassVar[float] = 20.0
    # Six slices with each candidate.
    coupling_cost_slices: ClassVar[float] = 6.0 * len(COUPLINGS)
    leaves_out: ClassVar[bool] = True

    weight: float | None = None
    non_negative: bool = True
    coupling: str = "auto"

    @property
    def coupling_is_open(self) -> bool:
        """Whether it is `auto`."""
        return self.coupling == "auto"

    @property
    def _coupling(self) -> float:
        """As a number; 0 while it is open."""
        return 0.0 if self.coupling in {"auto", "none"} else float(self.coupling)

    @property
    def halo(self) -> int:
        """Where slices are coupled, or may be."""
        return HALO if self.coupling_is_open or self._coupling > 0.0 else 0

    def with_coupling_chosen(
        self,
        projector: Projector,
        lines: Image,
        *,
        numbers: NDArray[np.int64],
        others_stay: bool,
        counts: bool,
        on_progress: OnProgress,
        left_out: LeftOut = None,
    ) -> Self:
        """By `choose_coupling`."""
        assert self.weight is not None  # noqa: S101 - chosen before
        found = choose_coupling(
            projector,
            lines,
            self.weight,
            numbers=numbers,
            weight_stays=others_stay,
            noise=noise_of_rays(lines, counts=counts, left_out=left_out),
            non_negative=self.non_negative,
            on_progress=on_progress,
        )
        return replace(self, coupling=f"{found.coupling:g}", weight=found.weight)

    @property
    def is_open(self) -> bool:
        """Whether the weight is to be chosen."""
        return self.weight is None

    def chosen(
        self,
        projector: Projector,
        line: Image,
        *,
        counts: bool,
        on_progress: OnProgress,
        left_out: LeftOut = None,
    ) -> Self:
        """With the weight of one slice."""
        choice = choose_weight(
            projector,
            line,
            noise=noise_of_rays(line[None], counts=counts, left_out=left_out),
            non_negative=self.non_negative,
            on_progress=on_progress,
        )
        return replace(self, weight=_weight_factor(self._coupling) * choice.weight)

    @property
    def choice(self) -> dict[str, float]:
        """The weight and the coupling, unless one of them is open."""
        if self.weight is None or self.coupling_is_open:
            return {}
        return {"weight": float(self.weight), "coupling": self._coupling}

    def with_choice(self, choice: Mapping[str, float]) -> Self:
        """With a weight that was chosen."""
        return replace(self, weight=choice["weight"], coupling=f"{choice['coupling']:g}")

    def reconstruct(
        self,
        projector: Projector,
        lines: Image,
        *,
        counts: bool,
        on_progress: OnProgress,
        left_out: LeftOut = None,
        numbers: NDArray[np.int64] | None = None,
    ) -> Estimate:
        """A block."""
        return total_variation(
            projector,
            lines,
            weight=self.weight,
            noise=noise_of_rays(lines, counts=counts, left_out=left_out),
            non_negative=self.non_negative,
            coupling=self._coupling * _neighbours(len(lines), numbers),
            on_progress=on_progress,
        )
