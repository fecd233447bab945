"""Smoothed total variation: convex, and the reference for other edge-preserving methods; and ring-aware variation."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import MULTIPLE
from sawmill_tomography.reconstruction.iterative.edge_preserving import (
    EdgePreservingMethod,
    PriorProblem,
    Settings,
    reconstruct_with_prior,
)
from sawmill_tomography.reconstruction.iterative.priors import TotalVariationPrior
from sawmill_tomography.reconstruction.iterative.progress import OnProgress
from sawmill_tomography.reconstruction.method import CANDIDATES_AT_ONCE, IMAGES_OF_A_DESCENT, FittedMethod
from sawmill_tomography.reconstruction.total_variation_weights import (
    COUPLINGS,
    TOLERANCE,
    USUAL_ITERATIONS,
    WeightChoice,
    axial_neighbours,
    choose_coupling,
    choose_ring_weight,
    choose_weight,
    smoothed_prior,
    weight_factor,
)

ITERATIONS = 300
# Price of a slice in projections forward and back, with the own pixels; a step comes with each
# (benchmarks/slice_price.py, 20 views).
USUAL_PAIRS = 24.0
# With directions across rings (benchmarks/tree_disc.py).
RING_PAIRS = 34.0
# A slice farther away changes a slice by less than the noise does.
HALO = 2
# The cost of choosing the weight, in iterations on one slice of 256 x 256 pixels from 20 views
# (benchmarks/choosing.py).
CHOOSING_COST = 210.0


def total_variation(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    weight: float | None = None,
    ring_weight: float | None = 1.0,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    coupling: ArrayLike = 0.0,
    on_progress: OnProgress | None = None,
) -> Estimate:
    """Reconstruct one slice or a block of slices by penalising the sum of differences (Rudin, Osher and Fatemi 1992).

    The objective is 1/2 sum ((A x - y) / noise)^2 + weight * sum (sqrt(|d|^2 + s^2) - s). The estimate's parameters are
    `weight`, `ring_weight` and `coupling`.

    With a ring weight below 1, |d|^2 is d_t^2 + ring_weight d_r^2: d_r across the growth rings, or across other
    structures that the slice's own first image shows, and d_t along them (docs/understand/reconstruction.md).

    With coupling, weight * coupling * sum (sqrt(d^2 + s^2) - s) of the differences along the axis is added.

    Parameters
    ----------
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air is at 0.
    weight : float, optional
        Weight in 1 / attenuation; by default chosen from the middle slice by cross-validation.
    ring_weight : float or None
        Weight of a difference across rings relative to one along them, above 0 to 1; None: chosen like the weight.
    coupling : float or (slices - 1,) float
        Coupling of each slice with the next one, 0 or more; 0 where they are not neighbours.
    noise, non_negative, iterations, tolerance, on_progress
        Parameters of `cauchy_map`.

    Raises
    ------
    GeometryError
        If shapes do not fit, a value is not positive, or a slice is 0 in every ray.
    """
    if weight is not None and not (np.isfinite(weight) and weight > 0.0):
        raise GeometryError(f"weight must be a positive number in 1 / attenuation, not {weight}")
    if ring_weight is not None and not 0.0 < ring_weight <= 1.0:
        raise GeometryError(f"ring_weight must be above 0 and at most 1, not {ring_weight}")

    problem = PriorProblem.of(projector, sinogram, noise, non_negative=non_negative, multiple=MULTIPLE)
    couplings, slices = np.asarray(coupling, np.float64), len(problem.lines)
    if couplings.shape not in {(), (slices - 1,)}:
        raise GeometryError(
            f"coupling must be one number, or {slices - 1} of them for {slices} slices, not of shape {couplings.shape}"
        )
    if not ((couplings >= 0.0).all() and np.isfinite(couplings).all()):
        raise GeometryError(f"coupling must be 0 or a positive number, not {couplings.min():g}")
    between = np.broadcast_to(couplings, slices - 1)
    strongest = float(between.max(initial=0.0))

    def settings(problem: PriorProblem, choice: WeightChoice | None) -> Settings:
        typical = problem.typical_attenuation
        weights = np.full(typical.shape, weight if choice is None else weight_factor(strongest) * choice.weight)
        rings = np.full(typical.shape, ring_weight if choice is None else choice.ring_weight)
        parameters = {"weight": weights, "ring_weight": rings, "coupling": np.array([strongest])}
        return Settings(problem.noises, smoothed_prior(typical, weights, rings), parameters, between)

    choose: Callable[..., WeightChoice] | None = None
    if ring_weight is None or (weight is None and ring_weight < 1.0):
        choose = partial(choose_ring_weight, weight=weight, ring_weight=ring_weight, non_negative=non_negative)
    elif weight is None:
        choose = partial(choose_weight, non_negative=non_negative)
    method = EdgePreservingMethod(
        choose=choose, settings=settings, choosing_cost=CHOOSING_COST, usual_iterations=USUAL_ITERATIONS, convex=True
    )
    return reconstruct_with_prior(method, problem, iterations=iterations, tolerance=tolerance, on_progress=on_progress)


# Ring-aware total variation: `total_variation` with the weight across rings chosen too.
ring_tv = partial(total_variation, ring_weight=None)


@dataclass(frozen=True)
class TotalVariation(FittedMethod):
    """The method `total_variation` in the table of methods, whose slices may help their neighbours."""

    least_images: ClassVar[int] = IMAGES_OF_A_DESCENT * CANDIDATES_AT_ONCE
    pairs_a_slice: ClassVar[float] = USUAL_PAIRS
    choosing_cost_slices: ClassVar[float] = 20.0
    # The choice reconstructs six slices with each candidate.
    coupling_cost_slices: ClassVar[float] = 6.0 * len(COUPLINGS)
    leaves_out: ClassVar[bool] = True
    weighs: ClassVar[bool] = True

    weight: float | None = None
    non_negative: bool = True
    coupling: str = "auto"

    @property
    def coupling_is_open(self) -> bool:
        """True if the coupling is `auto`, to be chosen from neighbouring slices."""
        return self.coupling == "auto"

    @property
    def _coupling(self) -> float:
        """Coupling as a number; 0 while it is open."""
        return 0.0 if self.coupling in {"auto", "none"} else float(self.coupling)

    @property
    def _ring_weight(self) -> float | None:
        """Weight across rings; None while it is open."""
        return 1.0

    @property
    def halo(self) -> int:
        """Slices beyond either end that affect a block; 0 unless slices are coupled or may be."""
        return HALO if self.coupling_is_open or self._coupling > 0.0 else 0

    def with_coupling_chosen(
        self,
        projector: Projector,
        lines: Image,
        *,
        numbers: NDArray[np.int64],
        others_stay: bool,
        noise: FloatArray,
        on_progress: OnProgress,
    ) -> Self:
        """Return the method, no other parameter open, with the coupling chosen from slices (slices, views, detector).

        Parameters
        ----------
        numbers
            Parameter of `reconstruct`.
        others_stay : bool
            True if the other parameters were given: they are then kept, whatever the coupling.
        """
        assert self.weight is not None and self._ring_weight is not None  # noqa: S101, PT018 - chosen before
        choice = choose_coupling(
            projector,
            lines,
            self.weight,
            ring_weight=self._ring_weight,
            numbers=numbers,
            weight_stays=others_stay,
            noise=noise,
            non_negative=self.non_negative,
            on_progress=on_progress,
        )
        return replace(self, coupling=f"{choice.coupling:g}", weight=choice.weight)

    def prior(self, typical: FloatArray) -> TotalVariationPrior:
        """Return the prior, with the weight chosen, of slices of these typical attenuations, (slices,)."""
        assert self.weight is not None and self._ring_weight is not None  # noqa: S101, PT018 - chosen before
        return smoothed_prior(typical, *(np.full(typical.shape, of) for of in (self.weight, self._ring_weight)))

    @property
    def alone(self) -> Self:
        """The method for a slice without neighbours, with the weight that smooths it as much."""
        weight = None if self.weight is None else self.weight / weight_factor(self._coupling)
        return replace(self, weight=weight, coupling="none")

    @property
    def is_open(self) -> bool:
        """True if the weight is to be chosen."""
        return self.weight is None

    def chosen(self, projector: Projector, line: Image, *, noise: FloatArray, on_progress: OnProgress) -> Self:
        """Return the method with the weight chosen for one slice."""
        choice = choose_weight(projector, line, noise=noise, non_negative=self.non_negative, on_progress=on_progress)
        return replace(self, weight=weight_factor(self._coupling) * choice.weight)

    @property
    def choice(self) -> dict[str, float]:
        """The weight and the coupling, unless one of them is open."""
        if self.weight is None or self.coupling_is_open:
            return {}
        return {"weight": float(self.weight), "coupling": self._coupling}

    def with_choice(self, choice: Mapping[str, float]) -> Self:
        """Return the method with a chosen weight and coupling."""
        return replace(self, weight=choice["weight"], coupling=f"{choice['coupling']:g}")

    def reconstruct(
        self,
        projector: Projector,
        lines: Image,
        *,
        noise: FloatArray,
        on_progress: OnProgress,
        numbers: NDArray[np.int64] | None = None,
    ) -> Estimate:
        """Reconstruct a block (`FittedMethod.reconstruct`).

        Parameters
        ----------
        numbers : (slices,) int64, optional
            Numbers of the slices along the log: consecutive numbers are neighbours. By default all slices are.
        """
        return total_variation(
            projector,
            lines,
            weight=self.weight,
            ring_weight=self._ring_weight,
            noise=noise,
            non_negative=self.non_negative,
            coupling=self._coupling * axial_neighbours(len(lines), numbers),
            on_progress=on_progress,
        )


@dataclass(frozen=True)
class RingTotalVariation(TotalVariation):
    """The method `ring_tv` in the table of methods."""

    pairs_a_slice: ClassVar[float] = RING_PAIRS
    choosing_cost_slices: ClassVar[float] = 2.0 * TotalVariation.choosing_cost_slices

    ring_weight: float | None = None

    @property
    def _ring_weight(self) -> float | None:
        return self.ring_weight

    @property
    def is_open(self) -> bool:
        """True if the weight or the weight across rings is to be chosen."""
        return self.weight is None or self.ring_weight is None

    def chosen(self, projector: Projector, line: Image, *, noise: FloatArray, on_progress: OnProgress) -> Self:
        """Return the method with both weights chosen for one slice."""
        choice = choose_ring_weight(
            projector,
            line,
            weight=self.weight,
            ring_weight=self.ring_weight,
            noise=noise,
            non_negative=self.non_negative,
            on_progress=on_progress,
        )
        weight = weight_factor(self._coupling) * choice.weight if self.weight is None else self.weight
        return replace(self, weight=weight, ring_weight=choice.ring_weight)

    @property
    def choice(self) -> dict[str, float]:
        """The weights and the coupling, unless one of them is open."""
        chosen = super().choice
        return {**chosen, "ring_weight": self.ring_weight} if chosen and self.ring_weight is not None else {}

    def with_choice(self, choice: Mapping[str, float]) -> Self:
        """Return the method with chosen weights and coupling."""
        return replace(super().with_choice(choice), ring_weight=choice["ring_weight"])
