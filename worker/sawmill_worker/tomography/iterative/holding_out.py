"""Choosing how far to trust the data: views and rays are kept back, and the image that foretells them best wins."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft, rfftfreq

from sawmill_worker.tomography.iterative.descent import Floats, Images
from sawmill_worker.tomography.iterative.penalised import WIDE_ITERATIONS, Objective, descend, widely
from sawmill_worker.tomography.iterative.telling import Told, descending, part_of
from sawmill_worker.tomography.projector import Image, Projector

# In each round a fifth of the views is kept back, and a tenth of the rays of the others.
ROUNDS = 5
HELD_SHARE = 0.1
TOLERANCE = 1e-3
# What is kept back is part of the method: equal data give equal answers.
SEED = 20


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What the candidates were worth, in r = (A x - y) / noise.

    Attributes
    ----------
    in_views : (candidates,) float64
        Mean over the views kept back of the power of r along the detector, each frequency w weighted by |w|^exponent;
        with the exponent 1 what the image itself is off by, in the directions of those views (Natterer 2001, section
        2.1), with a larger one above all its edges. 1 where there is one view only, which is not kept back.
    in_rays : (candidates,) float64
        Mean of r^2 over the rays kept back beside other rays of their views: what the image is off by in the directions
        that it was made from.
    images : (rounds, candidates, n, n) float32
        Found without what each round keeps back.
    """

    in_views: Floats
    in_rays: Floats
    images: Images


def bottom(candidates: Floats, errors: Floats) -> tuple[float, float]:
    """The best candidate and its error: the bottom of the parabola through the nearest one and its neighbours.

    In the logarithm of the candidates, which increase, equidistant there. At an end, that end.
    """
    at = int(np.argmin(errors))
    if not 0 < at < candidates.size - 1:
        return float(candidates[at]), float(errors[at])
    low, mid, high = errors[at - 1 : at + 2]
    step = 0.5 * (low - high) / (low - 2.0 * mid + high)
    ratio = candidates[at + 1] / candidates[at]
    return float(candidates[at] * ratio**step), float(mid - 0.25 * (low - high) * step)


def shown_without(objective: Objective, start: Image, *, non_negative: bool, told: Told | None = None) -> Images:
    """What the widened prior of one image shows without what each round keeps back, (rounds, n, n), from (n, n)."""
    weights = np.concatenate([one.without(objective).weights for one in _rounds(objective.projector)])
    return widely(
        replace(objective, weights=weights, prior=objective.prior.each(len(weights))),
        np.repeat(start[None], len(weights), axis=0),
        non_negative=non_negative,
        tolerance=TOLERANCE,
        progress=descending(part_of(told, 0.0, 1.0), WIDE_ITERATIONS),
    )


def hold_out(
    objective: Objective,
    noise: Floats,
    starts: Images,
    *,
    exponent: float,
    iterations: int,
    non_negative: bool,
    told: Told | None = None,
) -> HeldOut:
    """Try candidates side by side on one slice, in rounds that each keep back other views and rays.

    Parameters
    ----------
    objective : Objective
        With one sinogram, and the weights and the prior of each candidate.
    noise : float64, broadcasts with (views, detector)
    starts : (rounds, n, n) float32
        Found without what each round keeps back, as `shown_without` and `HeldOut.images` are.
    told : callable, optional
        Told the share of the work that is done.
    """
    projector, count = objective.projector, objective.prior.scale.size
    found, in_views, in_rays, rays = [], np.zeros(count), np.zeros(count), 0
    for index, (one, start) in enumerate(zip(_rounds(projector), starts, strict=True)):
        images = descend(
            one.without(objective),
            np.repeat(start[None], count, axis=0),
            non_negative=non_negative,
            iterations=iterations,
            tolerance=TOLERANCE,
            progress=descending(part_of(told, index / len(starts), 1.0 / len(starts)), iterations),
        ).images
        missed = np.where(projector.crossing, (projector.forward(images) - objective.lines) / noise, 0.0)
        in_views += _power(missed[:, one.views], exponent)
        in_rays += np.square(missed[:, one.beside]).sum(axis=1)
        rays += int(one.beside.sum())
        found.append(images)
    views = projector.geometry.angles_rad.size
    return HeldOut(in_views / views if len(starts) > 1 else np.ones(count), in_rays / rays, np.stack(found))


@dataclass(frozen=True, eq=False)
class _Round:
    """What is kept back together.

    Attributes
    ----------
    views : (views,) bool
    beside : (views, detector) bool
        Rays of other views.
    """

    views: NDArray[np.bool_]
    beside: NDArray[np.bool_]

    def without(self, objective: Objective) -> Objective:
        held = self.beside | self.views[:, None]
        return replace(objective, weights=np.where(held, np.float32(0.0), objective.weights))


def _rounds(projector: Projector) -> Iterator[_Round]:
    """One of each ROUNDS neighbouring views in turns, in random order; a single view is not kept back."""
    rng = np.random.default_rng(SEED)
    crossing = projector.crossing
    views = len(crossing)
    count = min(ROUNDS, views)
    turns = np.concatenate([rng.permutation(count) for _ in range(-(-views // count))])[:views]
    for turn in range(count):
        held = (turns == turn) & (count > 1)
        beside = crossing & ~held[:, None] & (rng.uniform(size=crossing.shape) < HELD_SHARE)
        yield _Round(held, beside)


def _power(residual: Floats, exponent: float) -> Floats:
    """Sum over the views of (candidates, views, detector) of the power, weighted by |w|^exponent; (candidates,)."""
    cells = residual.shape[-1]
    power = np.square(np.abs(rfft(residual, 2 * cells, axis=-1))).sum(axis=1)
    return np.asarray(power @ rfftfreq(2 * cells) ** exponent / cells)
