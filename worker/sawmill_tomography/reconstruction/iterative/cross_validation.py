"""Cross-validation: candidates are compared by how well their images predict views and rays that were left out."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images
from sawmill_tomography.reconstruction.iterative.penalised import (
    CONTINUATION_ITERATIONS,
    Objective,
    continuation,
    descend,
)
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, counting_iterations, part_of

# The validation data of a fold: a fifth of the views, and a tenth of the rays of the other views.
FOLDS = 5
VALIDATION_RAYS_SHARE = 0.1
# The descents need not converge further to rank the candidates (benchmarks/choosing.py).
TOLERANCE = 1e-3
# The folds are part of the method: equal data give equal answers.
SEED = 20


@dataclass(frozen=True, eq=False)
class ValidationErrors:
    """The errors of the candidates, in r = (A x - y) / noise."""

    in_views: Floats  # (candidates,)
    in_rays: Floats  # (candidates,)
    images: Images  # (folds, candidates, n, n) float32: images made without the validation data of each fold


def parabola_minimum(candidates: Floats, errors: Floats) -> tuple[float, float]:
    """Return the best candidate and its error: the minimum of the parabola through the best sample and its neighbours.

    The parabola is in the logarithm of the candidates, which increase in equal steps there. At an end, that end is
    returned.
    """
    at = int(np.argmin(errors))
    if not 0 < at < candidates.size - 1:
        return float(candidates[at]), float(errors[at])
    low, mid, high = errors[at - 1 : at + 2]
    step = 0.5 * (low - high) / (low - 2.0 * mid + high)
    ratio = candidates[at + 1] / candidates[at]
    return float(candidates[at] * ratio**step), float(mid - 0.25 * (low - high) * step)


def first_images_of_folds(
    objective: Objective, start: Image, *, non_negative: bool, on_progress: OnProgress | None = None
) -> Images:
    """Return the image of `continuation` without the validation data of each fold, (folds, n, n), from (n, n)."""
    weights = np.concatenate([fold.training(objective).weights for fold in _folds(objective.projector)])
    return continuation(
        replace(objective, weights=weights, prior=objective.prior.repeated(len(weights))),
        np.repeat(start[None], len(weights), axis=0),
        non_negative=non_negative,
        tolerance=TOLERANCE,
        on_iteration=counting_iterations(part_of(on_progress, 0.0, 1.0), CONTINUATION_ITERATIONS),
    )


def cross_validate(
    objective: Objective,
    noise: Floats,
    starts: Images,
    *,
    exponent: float,
    iterations: int,
    non_negative: bool,
    on_progress: OnProgress | None = None,
) -> ValidationErrors:
    """Reconstruct one slice with all candidates, in folds that each leave out different views and rays.

    `starts` (folds, n, n) float32: images made without the validation data of each fold, by `first_images_of_folds` or
    an earlier cross-validation.
    """
    projector, count = objective.projector, objective.prior.scale.size
    images_of_folds, in_views, in_rays, rays = [], np.zeros(count), np.zeros(count), 0
    for index, (fold, start) in enumerate(zip(_folds(projector), starts, strict=True)):
        images = descend(
            fold.training(objective),
            np.repeat(start[None], count, axis=0),
            non_negative=non_negative,
            iterations=iterations,
            tolerance=TOLERANCE,
            on_iteration=counting_iterations(part_of(on_progress, index / len(starts), 1.0 / len(starts)), iterations),
        ).images
        residual = np.where(projector.crossing, (projector.forward(images) - objective.lines) / noise, 0.0)
        in_views += power_along_detector(residual[:, fold.views], exponent)
        in_rays += np.square(residual[:, fold.rays]).sum(axis=1)
        rays += int(fold.rays.sum())
        images_of_folds.append(images)
    views = projector.geometry.angles_rad.size
    return ValidationErrors(
        in_views / views if len(starts) > 1 else np.ones(count), in_rays / rays, np.stack(images_of_folds)
    )


@dataclass(frozen=True, eq=False)
class _Fold:
    """Validation data that are left out together."""

    views: NDArray[np.bool_]  # (views,) bool
    rays: NDArray[np.bool_]  # (views, detector) bool: rays of other views

    def training(self, objective: Objective) -> Objective:
        """Return the objective of all other data."""
        return replace(objective, weights=np.where(self.rays | self.views[:, None], np.float32(0.0), objective.weights))


def _folds(projector: Projector) -> Iterator[_Fold]:
    """Yield folds with one of every FOLDS neighbouring views, in random order; a single view is not left out."""
    rng = np.random.default_rng(SEED)
    crossing = projector.crossing
    views = len(crossing)
    count = min(FOLDS, views)
    fold_of_view = np.concatenate([rng.permutation(count) for _ in range(-(-views // count))])[:views]
    for fold in range(count):
        left_out = (fold_of_view == fold) & (count > 1)
        rays = crossing & ~left_out[:, None] & (rng.uniform(size=crossing.shape) < VALIDATION_RAYS_SHARE)
        yield _Fold(left_out, rays)


def power_along_detector(residual: Floats, exponent: float) -> Floats:
    """Sum the power, weighted by |w|^exponent, over the views of (candidates, views, detector); (candidates,)."""
    cells = residual.shape[-1]
    power = np.square(np.abs(scipy.fft.rfft(residual, 2 * cells, axis=-1))).sum(axis=1)
    return np.asarray(power @ scipy.fft.rfftfreq(2 * cells) ** exponent / cells)
