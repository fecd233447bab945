"""Choosing how far to trust the data: some rays are kept back, and the image that foretells them best wins."""

from dataclasses import dataclass, replace

import numpy as np

from worker.tomography.iterative.descent import Floats, Images
from worker.tomography.iterative.penalised import WIDE_ITERATIONS, Objective, descend, widely
from worker.tomography.iterative.telling import Phases, Told

HELD_SHARE = 0.15
ITERATIONS = 10
TOLERANCE = 1e-3
# Misses beyond so many times the noise weigh little: the few rays along an edge of bark or metal, which pixels cannot
# show, would decide otherwise.
LARGE = 2.0
# What the widened prior costs beside the candidates: one image alone against several side by side.
WIDENED_COST = 0.3
# Which rays are kept back is part of the method: equal data give equal answers.
SEED = 20


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What the candidates were worth.

    Attributes
    ----------
    errors : (candidates,) float64
        Mean of log(1 + (r / LARGE)^2), r = (A x - y) / noise, over the rays kept back.
    images : (candidates, n, n) float32
    """

    errors: Floats
    images: Images

    @property
    def nearest(self) -> int:
        """The best of the candidates tried."""
        return int(np.argmin(self.errors))


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


def hold_out(
    objective: Objective, noise: Floats, start: Images, *, non_negative: bool, told: Told | None = None
) -> HeldOut:
    """Try candidates side by side on one slice, without the rays kept back.

    Parameters
    ----------
    objective : Objective
        With one sinogram, and the weights and the prior of each candidate.
    noise : float64, broadcasts with (views, detector)
    start : (n, n) float32
    told : callable, optional
        Told the share of the work that is done.
    """
    rng = np.random.default_rng(SEED)
    crossing = objective.projector.forward(np.ones_like(start)) > 0.0
    held = crossing & (rng.uniform(size=crossing.shape) < HELD_SHARE)
    kept = replace(objective, weights=np.where(held, np.float32(0.0), objective.weights))
    # What the widened prior shows is much the same for all candidates: the middle one's serves them.
    count = objective.prior.scale.size
    phases = Phases(told, widened=WIDENED_COST, tried=1.0)
    shown = widely(
        kept.only(count // 2),
        start[None],
        non_negative=non_negative,
        tolerance=TOLERANCE,
        progress=phases.descent("widened", WIDE_ITERATIONS),
    )
    found = descend(
        kept,
        np.repeat(shown, count, axis=0),
        non_negative=non_negative,
        iterations=ITERATIONS,
        tolerance=TOLERANCE,
        progress=phases.descent("tried", ITERATIONS),
    )
    relative = (objective.projector.forward(found.images) - objective.lines) / noise
    missed = np.log1p(np.square(relative[:, held] / LARGE, dtype=np.float64))
    return HeldOut(missed.mean(axis=1), found.images)
