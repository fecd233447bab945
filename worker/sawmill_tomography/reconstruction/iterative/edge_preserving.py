"""The skeleton of the methods with an edge-preserving prior: choose, continuation, descent.

Parameters that are not given are chosen from the middle slice. Continuation in the prior's scale leads to a
first image where the objective has many minima. The descent runs on the support region, and then on the full grid.
An objective with one minimum is minimised on the support region alone, through larger pixels.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import (
    descend_by_levels,
    mean_along_rays,
    typical_attenuation,
)
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images
from sawmill_tomography.reconstruction.iterative.penalised import (
    CONTINUATION_ITERATIONS,
    Objective,
    continuation,
    weights_of,
)
from sawmill_tomography.reconstruction.iterative.priors import Prior
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, Phases, cost_of_images
from sawmill_tomography.reconstruction.iterative.support_region import SupportRegion, descend_from_support
from sawmill_tomography.reconstruction.object_extent import check_shown
from sawmill_tomography.sinograms.noise import data_misfit, noise_of_each_ray, remarks_on, rms_noise

# Size of the pixels that show a slice's typical attenuation, in own pixels.
LARGE_PIXEL = 4


@dataclass(frozen=True, eq=False)
class PriorProblem:
    """The data of one slice or of a block, and the pixels that explain them."""

    projector: Projector
    lines: Images  # (slices, views, detector) float32: line integrals whose air is at 0
    noises: Floats  # standard deviation of each line integral; infinite for one that is left out
    support: SupportRegion
    non_negative: bool
    is_block: bool  # True if the input was a block, perhaps of one slice

    @classmethod
    def of(
        cls,
        projector: Projector,
        sinogram: ArrayLike,
        noise: ArrayLike | None,
        *,
        non_negative: bool,
        multiple: int = 1,
    ) -> "PriorProblem":
        """Make the problem of sinograms (views, detector) or (slices, views, detector); noise defaults to the air's.

        The support region's size is a multiple of `multiple`.
        """
        lines = projector.block(sinogram)
        check_shown(lines)
        noises = noise_of_each_ray(noise, lines)
        # With the bound the air around the log needs little reconstruction.
        support = SupportRegion.of(projector, lines, non_negative=non_negative, multiple=multiple)
        return cls(projector, lines, noises, support, non_negative, np.ndim(sinogram) == 3)

    @cached_property
    def first_images(self) -> Images:
        """First image of each slice on the support region, (slices, n, n)."""
        return mean_along_rays(self.support.projector, self.lines)

    @cached_property
    def typical_attenuation(self) -> Floats:
        """Typical attenuation of each slice, (slices,), from first images with large pixels, which show it as well."""
        grid = self.support.projector.grid
        large = ImageGrid(max(grid.size // LARGE_PIXEL, 1), grid.field_mm, grid.centre_mm)
        return typical_attenuation(mean_along_rays(Projector(self.projector.geometry, large), self.lines))


class Choice(Protocol):
    """Parameters chosen from one slice."""

    @property
    def image(self) -> Image:
        """The slice (size, size), near its image with the chosen parameters."""


ChoiceT = TypeVar("ChoiceT", bound=Choice)


@dataclass(frozen=True, eq=False)
class Settings:
    """The objective's settings for a block."""

    sigmas: Floats  # assumed standard deviation of the data
    prior: Prior
    parameters: Mapping[str, Floats]  # parameters for `Estimate`
    coupling: Floats | None = None  # (slices - 1,): coupling of neighbouring slices, where the objective is convex


@dataclass(frozen=True, eq=False)
class EdgePreservingMethod(Generic[ChoiceT]):
    """Parts of the skeleton that a method defines."""

    choose: Callable[..., ChoiceT] | None  # (projector, sinogram, *, noise, on_progress) to a choice for one slice
    settings: Callable[[PriorProblem, ChoiceT | None], Settings]  # the settings for a block, from the choice
    choosing_cost: float  # cost of the choice, in iterations on one slice
    usual_iterations: int  # iterations after which most logs have converged
    convex: bool = False
    as_published: bool = False  # True for no continuation and no preconditioner


def reconstruct_with_prior(
    method: EdgePreservingMethod[ChoiceT],
    problem: PriorProblem,
    *,
    iterations: int,
    tolerance: float,
    on_progress: OnProgress | None = None,
) -> Estimate:
    """Choose the open parameters, and descend from a first image to the minimum of the objective."""
    lines, noises, non_negative = problem.lines, problem.noises, problem.non_negative
    # The choice for a single slice gives an image nearer to the minimum than continuation's.
    has_near_image = method.choose is not None and len(lines) == 1
    continued = not (has_near_image or method.convex or method.as_published)
    block_cost = cost_of_images(len(lines))
    phases = Phases(
        on_progress,
        choose=0.0 if method.choose is None else method.choosing_cost,
        continuation=CONTINUATION_ITERATIONS * block_cost if continued else 0.0,
        descent=method.usual_iterations * block_cost,
    )
    choice = None if method.choose is None else _from_middle_slice(method.choose, problem, phases.of("choose"))
    settings = method.settings(problem, choice)
    weights = weights_of(settings.sigmas, lines.shape)
    near = choice.image[None] if choice is not None and has_near_image else None
    on_descent = phases.of("descent")
    if method.convex:
        minimum = descend_by_levels(
            Objective(problem.support.projector, lines, weights, settings.prior),
            near,
            non_negative=non_negative,
            iterations=iterations,
            tolerance=tolerance,
            usual=method.usual_iterations,
            coupling=settings.coupling,
            on_progress=on_descent,
        )
        minimum = replace(minimum, images=problem.support.embedded(minimum.images))
    else:
        start = problem.first_images if near is None else near
        if continued:
            start = continuation(
                Objective(problem.support.projector, lines, weights, settings.prior),
                start,
                non_negative=non_negative,
                tolerance=tolerance,
                on_iteration=phases.descent("continuation", CONTINUATION_ITERATIONS),
            )
        minimum = descend_from_support(
            Objective(problem.projector, lines, weights, settings.prior),
            problem.support,
            start,
            non_negative=non_negative,
            iterations=iterations,
            tolerance=tolerance,
            usual=method.usual_iterations,
            preconditioned=not method.as_published,
            on_progress=on_descent,
        )
    misfit = data_misfit(problem.projector, minimum.images, lines, noises)
    return Estimate(
        image=minimum.images.reshape(minimum.images.shape if problem.is_block else minimum.images.shape[1:]),
        iterations=minimum.iterations,
        converged=minimum.converged,
        parameters=settings.parameters,
        noise=rms_noise(noises),
        misfit=misfit,
        objective=minimum.values,
        remarks=(() if method.as_published else minimum.remarks)
        + remarks_on(problem.projector, minimum.images, misfit, lines, noises),
    )


def _from_middle_slice(choose: Callable[..., ChoiceT], problem: PriorProblem, on_progress: OnProgress) -> ChoiceT:
    middle = len(problem.lines) // 2
    noise = np.broadcast_to(problem.noises, problem.lines.shape)[middle]
    return choose(problem.support.projector, problem.lines[middle], noise=noise, on_progress=on_progress)
