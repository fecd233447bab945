"""Whether the phantom, or the angles, kept still during the scan.

What the fit left of the scan is compared, to first order, with what a jump of the pose from some view on, angles that
run too fast or too slowly, and angles that swing once a turn would have left. Every inner product that this needs is in
the per-view Gram matrices of least squares.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from worker.tomography.analytic import PARAMETERS
from worker.tomography.calibration.refine import DATA, MODEL, ONE, Fit, SinogramData, project_out, seen_views
from worker.tomography.calibration.structure import shared_power
from worker.tomography.geometry import FloatArray

PSI, T_X, T_Y = 0, 5, 6
# A wrong drawing or wood that is not uniform looks like one of these by a tenth; a phantom that moved 20 mm, far beyond
# first order, by a half.
EXPLAINS = 0.4
# Of white noise the best of several hundred jumps takes so many variances once in a thousand scans.
CHANCE = 30.0
# Levels of the model in each of which noise is alike.
LEVELS = 8
# Stretches of the scan in which what is left of the pose is looked at.
STRETCHES = (8, 16, 32, 64)
# A jump is known by so many views, and such a share of them, before and after it.
FEWEST_VIEWS, SHARE_OF_VIEWS = 5, 1 / 16
# A jump that moves the phantom by less than this share of what it turns its rim by is one of the angles.
TURN_ALONE = 0.1


class Change(StrEnum):
    """What changed."""

    PHANTOM = "phantom"
    ANGLES = "angles"
    PACE = "pace"
    SWING = "swing"


@dataclass(frozen=True, eq=False)
class Unsteadiness:
    """What changed during the scan.

    Attributes
    ----------
    change : Change
    explains : float
        The share of the residual's power, less that of noise, which this accounts for.
    bias : (7,) float64
        By how much (psi, R, SDD, u_c, tau, t_x, t_y) are off for not knowing of it.
    by_deg, by_mm : float
        Turn and move of the phantom in a jump; the most that angles are off in a swing.
    view : int
        The first view after a jump.
    pace : float
        How far the turntable turns while the angles say 1.
    """

    change: Change
    explains: float
    bias: FloatArray
    by_deg: float = 0.0
    by_mm: float = 0.0
    view: int = 0
    pace: float = 1.0


def find_unsteadiness(
    grams: FloatArray, data: SinogramData, fit: Fit, residual: FloatArray, model: FloatArray, *, radius_mm: float
) -> Unsteadiness | None:
    """What explains most of a residual (views, cells) beside the model that left it, if anything here does.

    Parameters
    ----------
    grams : (views, 10 or 13, 10 or 13) float64
        `analytic.gram` at the fit.
    residual : (views, cells) float64
        0 where nothing may be used.
    radius_mm : float
        Of the phantom.
    """
    left = _Left(grams, data, fit, shared_power(residual))
    candidates = [_pace(left), _swing(left)]
    if len(grams) >= 2 * FEWEST_VIEWS:
        candidates.append(_jump(left, radius_mm))
    best = max(candidates, key=lambda candidate: candidate.power)
    if best.change.explains < EXPLAINS or best.power < CHANCE * left.variance_without(best):
        return None
    lacking = float((residual**2).mean()) - _noise(residual, model)
    return best.change if best.power > EXPLAINS * lacking * residual.size else None


def _noise(residual: FloatArray, model: FloatArray) -> float:
    """Mean variance of the noise, which may go by what is measured, whatever is large in single samples."""
    depth = (model - model.min()) / max(float(np.ptp(model)), np.finfo(np.float64).tiny)
    level = np.minimum((depth[:, 1:] * LEVELS).astype(np.intp), LEVELS - 1)
    steps = np.abs(np.diff(residual, axis=1))
    total = 0.0
    for at in range(LEVELS):
        here = steps[(level == at) & (steps > 0.0)]
        if here.size:
            total += here.size * (1.4826 * float(np.median(here))) ** 2 / 2.0
    return total / steps.size


@dataclass(frozen=True, eq=False)
class _Explanation:
    """What additional derivatives explain: power, its share, and what the fit is off by.

    `coefficients` are the added terms', `known` those of the fit's own terms beside them; of `trial`, the best.
    """

    power: float
    share: float
    coefficients: FloatArray
    known: FloatArray
    bias: FloatArray
    trial: int


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A change, and the derivatives, each times its shape (terms, views), that show it."""

    change: Unsteadiness
    which: list[int]
    shapes: FloatArray
    found: _Explanation

    @property
    def power(self) -> float:
        """Of the residual, explained by it."""
        return self.found.power


class _Left:
    """What the fit left, and how much of it additional derivatives explain."""

    def __init__(self, grams: FloatArray, data: SinogramData, fit: Fit, shared: float) -> None:
        self.angles = data.angles_rad
        self._free = [i for i in range(PARAMETERS) if fit.covariance[i, i] > 0.0]
        self._gain = fit.gain
        if data.view_gain:
            rest = [*range(PARAMETERS), DATA, *data.extras]
            seen = seen_views(grams)
            free_of_them = np.zeros_like(grams)
            free_of_them[np.ix_(np.flatnonzero(seen), rest, rest)] = project_out(grams[seen], [MODEL, ONE], rest)[0]
            self.grams, linear = free_of_them, list(data.extras)
        else:
            self.grams, linear = grams, [MODEL, ONE, *data.extras]
        self._known = [*self._free, *linear]
        self._total = self.grams.sum(axis=0)
        self._scale = 1.0 / np.sqrt(np.diag(self._total)[self._known])
        self._rss = project_out(self._total, self._known, [DATA])[0].item()
        self._beyond_noise, self._samples = shared * data.sinogram.size, data.samples

    def shaped(self, which: list[int], shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inner products of derivatives `which`, each times its shape (terms, views): with all, and their own."""
        grams = self.grams[:, which]
        return np.einsum("tk,kti->ti", shapes, grams), np.einsum("tk,sk,kts->ts", shapes, shapes, grams[:, :, which])

    def explained(self, products: FloatArray, own: FloatArray) -> _Explanation:
        """By the best of some trials: products (trials, terms, 10 or 13), own (trials, terms, terms)."""
        cross = products[:, :, self._known] * self._scale
        normal = self._total[np.ix_(self._known, self._known)] * np.outer(self._scale, self._scale)
        solved = np.linalg.solve(normal, np.swapaxes(cross, 1, 2))
        matrix = own - cross @ solved
        data = self._scale * self._total[self._known, DATA]
        right = products[:, :, DATA] - data @ solved
        coefficients = (np.linalg.pinv(matrix, rcond=1e-9, hermitian=True) @ right[..., None])[..., 0]
        powers = np.einsum("nt,nt->n", right, coefficients)
        best = int(powers.argmax())
        # Where nothing is left to explain, rounding may be negative.
        power, bias = max(float(powers[best]), 0.0), np.zeros(PARAMETERS)
        moved = -(solved[best] @ coefficients[best]) * self._scale
        bias[self._free] = moved[: len(self._free)] / self._gain
        known = np.linalg.solve(normal, data) * self._scale + moved
        # What is not noise cannot be less than what is explained.
        share = power / max(power, self._beyond_noise, np.finfo(np.float64).tiny)
        return _Explanation(power, share, coefficients[best], known, bias, best)

    def variance_without(self, candidate: _Candidate) -> float:
        """Of a sample, once the candidate is taken out: as large as the pose scatters from stretch to stretch.

        Where a model is finer than the scan's rays, or lacks something, the residual is large just where the pose
        matters, and goes on from view to view. What is left in the pose of some views together says so.
        """
        pose, found = [PSI, T_X, T_Y], candidate.found
        grams = self.grams[:, pose]
        scores = grams[:, :, DATA] - grams[:, :, self._known] @ found.known
        scores -= np.einsum("tk,kpt,t->kp", candidate.shapes, grams[:, :, candidate.which], found.coefficients)
        own = np.einsum("kpp->kp", grams[:, :, pose])
        variance = max(self._rss - found.power, 0.0) / self._samples
        for stretches in STRETCHES:
            first = np.unique(np.linspace(0, len(grams), stretches, endpoint=False).astype(np.intp))
            power, expected = np.add.reduceat(scores, first) ** 2, np.add.reduceat(own, first)
            seen = expected > 1e-9 * expected.max(axis=0)
            variance = max(variance, float((power[seen] / expected[seen]).mean()))
        return variance

    def in_parameters(self, found: _Explanation) -> FloatArray:
        """Its coefficients in radians and mm."""
        return found.coefficients / self._gain


def _jump(left: _Left, radius_mm: float) -> _Candidate:
    """Of the pose, from some view on."""
    pose, views = [PSI, T_X, T_Y], len(left.grams)
    fewest = max(FEWEST_VIEWS, round(SHARE_OF_VIEWS * views))
    # Of the views from each on, the first and the last few left out.
    after = np.cumsum(left.grams[::-1, pose], axis=0)[::-1][fewest : views - fewest + 1]
    found = left.explained(after, after[:, :, pose])
    turn, *move = left.in_parameters(found)
    by_mm, view = math.hypot(*move), fewest + found.trial
    change = Unsteadiness(
        Change.ANGLES if by_mm < TURN_ALONE * abs(turn) * radius_mm else Change.PHANTOM,
        found.share,
        found.bias,
        by_deg=math.degrees(abs(turn)),
        by_mm=by_mm,
        view=view,
    )
    return _Candidate(change, pose, np.tile((np.arange(views) >= view).astype(np.float64), (3, 1)), found)


def _pace(left: _Left) -> _Candidate:
    """Angles that run too fast or too slowly."""
    shapes = (left.angles - left.angles.mean())[None]
    products, own = left.shaped([PSI], shapes)
    found = left.explained(products[None], own[None])
    change = Unsteadiness(Change.PACE, found.share, found.bias, pace=1.0 + float(left.in_parameters(found)[0]))
    return _Candidate(change, [PSI], shapes, found)


def _swing(left: _Left) -> _Candidate:
    """Angles that are ahead and behind once a turn."""
    shapes = np.stack([np.cos(left.angles), np.sin(left.angles)])
    products, own = left.shaped([PSI, PSI], shapes)
    found = left.explained(products[None], own[None])
    by_deg = math.degrees(math.hypot(*left.in_parameters(found)))
    return _Candidate(Unsteadiness(Change.SWING, found.share, found.bias, by_deg=by_deg), [PSI, PSI], shapes, found)
