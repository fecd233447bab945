"""Whether the phantom moved during the scan, or the angles are not those of the turntable.

The residual of the fit is compared, to first order, with what a jump of the pose from some view on, angles that
run too fast or too slowly, and angles that swing once a turn would leave. Each is judged by its own pattern alone:
samples weigh by their noise, and a pattern counts where it explains many times what the pose scatters by from stretch
to stretch of the scan once the pattern is taken out. What else the residual holds, such as stripes of a short flat
field, has no part in it. Every inner product that this needs is in the per-view Gram matrices of least squares.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from sawmill_worker.tomography.calibration.elimination import project_out, seen_views
from sawmill_worker.tomography.calibration.fit import Fit
from sawmill_worker.tomography.calibration.sinogram_data import SinogramData
from sawmill_worker.tomography.fit_parameters import POSE, GramTerm, Parameter
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.tomography.phantom import Phantom

# A pattern is no chance when it explains this multiple of the variance of a sample: the best of several hundred jumps
# reaches 30 in one of a thousand scans of white noise.
CHANCE = 35.0
# It is no fault of a few views when its size, squared, is this multiple of its variance from view to view. Both figures
# stand between what steady scans and what slips reach: benchmarks/unsteady.py.
IN_ALL_VIEWS = 20.0
# Added to scaled normal equations of which the rest without one view may not be enough.
REGULARISATION = 1e-9
# Levels of the model in each of which noise is alike, and the number of samples that are enough to measure it.
LEVELS, ENOUGH = 8, 50
# Noise is measured on about this number of samples. A level's is at least this share of the mean: air may have none.
MEASURED, LEAST_NOISE = 20_000, 0.05
# Stretches of the scan in which the rest of the pose is compared.
STRETCHES = (8, 16, 32, 64)
# A jump is known by this number of views, and this share of them, before and after it.
FEWEST_VIEWS, SHARE_OF_VIEWS = 3, 1 / 16
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
    bias : (7,) float64
        Of the seven unknowns, in the order of `Parameter`, when it is not modelled.
    by_deg, by_mm : float
        Turn and move of the phantom in a jump; the most that angles are off in a swing.
    view : int
        The first view after a jump.
    pace : float
        How far the turntable turns while the angles say 1.
    """

    change: Change
    bias: FloatArray
    by_deg: float = 0.0
    by_mm: float = 0.0
    view: int = 0
    pace: float = 1.0


def find_unsteadiness(
    phantom: Phantom, data: SinogramData, fit: Fit, grams: FloatArray, residual: FloatArray, model: FloatArray
) -> Unsteadiness | None:
    """What changed during the scan that explains this residual (views, cells) of the model, if anything here does.

    Parameters
    ----------
    phantom : Phantom
        As it is seen.
    grams : (views, 10 or 13, 10 or 13) float64
        `analytic.gram` at the fit.
    residual : (views, cells) float64
        0 where nothing may be used.
    """
    by_noise = replace(data, weights=_noise_weights(data, residual, model))
    by_weight = _ResidualPatterns(by_noise.gram(phantom, fit.to_vector(), fit.hardening), by_noise, fit)
    patterns = [_pace(by_weight), _swing(by_weight)]
    if len(grams) >= 2 * FEWEST_VIEWS:
        patterns.append(_jump(by_weight))
    best = max(patterns, key=lambda pattern: pattern.found.power)
    if best.found.power < CHANCE * by_weight.variance_without(best) or by_weight.significance(best) < IN_ALL_VIEWS:
        return None
    return _described(
        best, by_weight.in_parameters(best), _ResidualPatterns(grams, data, fit).bias_of(best), phantom.radius_mm
    )


def _noise_weights(data: SinogramData, residual: FloatArray, model: FloatArray) -> FloatArray:
    """One over the noise's variance times the weights that samples have, (views, cells); 1 in the mean where not 0.

    Noise may go by what is measured, as that of photons does; from cell to cell it is not shared.
    """
    low, high = float(model.min()), float(model.max())
    per_level = LEVELS * (1.0 - 1e-9) / max(high - low, np.finfo(np.float64).tiny)
    level = ((model - low) * per_level).astype(np.uint8)
    views = slice(None, None, max(1, residual.size // MEASURED))
    steps, at = np.abs(np.diff(residual[views], axis=1)), level[views, 1:]
    variance = np.zeros(LEVELS)
    for one in range(LEVELS):
        here = steps[at == one]
        here = here[here > 0.0]
        if here.size >= ENOUGH:
            variance[one] = float(np.median(here)) ** 2
    known = np.flatnonzero(variance)
    if known.size == 0:  # of an exact scan nothing is noise
        return np.ones_like(residual) if data.weights is None else data.weights
    variance = np.interp(np.arange(LEVELS), known, variance[known])
    inverse = 1.0 / np.maximum(variance, LEAST_NOISE * variance.mean())
    weights: FloatArray = inverse[level]
    if data.weights is not None:
        weights *= data.weights
    weights *= np.count_nonzero(weights) / weights.sum()
    return weights


@dataclass(frozen=True, eq=False)
class _Explanation:
    """What additional derivatives explain of the residual's power.

    `coefficients` are the added terms', `known` those of the fit's own terms beside them; of `trial`, the best.
    """

    power: float
    coefficients: FloatArray
    known: FloatArray
    trial: int


@dataclass(frozen=True, eq=False)
class _Pattern:
    """A change, and the derivatives, each times its shape (terms, views), that show it."""

    change: Change
    which: list[Parameter]
    shapes: FloatArray
    found: _Explanation


class _ResidualPatterns:
    """The residual of a fit, and how much of it additional derivatives explain."""

    def __init__(self, grams: FloatArray, data: SinogramData, fit: Fit) -> None:
        self.angles = data.angles_rad
        self._free = fit.covariance.determined
        self._gain = fit.gain
        if data.view_gain:
            rest = [*Parameter, GramTerm.DATA, *data.extras]
            seen = seen_views(grams)
            free_of_them = np.zeros_like(grams)
            free_of_them[np.ix_(np.flatnonzero(seen), rest, rest)] = project_out(
                grams[seen], [GramTerm.SHADOW, GramTerm.ONE], rest
            )[0]
            self.grams, linear = free_of_them, list(data.extras)
        else:
            self.grams, linear = grams, [GramTerm.SHADOW, GramTerm.ONE, *data.extras]
        self._known = [*self._free, *linear]
        self._total = self.grams.sum(axis=0)
        self._scale = 1.0 / np.sqrt(np.diag(self._total)[self._known])
        self._normal = self._total[np.ix_(self._known, self._known)] * np.outer(self._scale, self._scale)
        self._samples = data.samples

    def shaped(self, which: list[Parameter], shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inner products of derivatives `which`, each times its shape (terms, views): with all, and their own."""
        grams = self.grams[:, which]
        return np.einsum("tk,kti->ti", shapes, grams), np.einsum("tk,sk,kts->ts", shapes, shapes, grams[:, :, which])

    def explained(self, products: FloatArray, own: FloatArray) -> _Explanation:
        """By the best of some trials: products (trials, terms, 10 or 13), own (trials, terms, terms)."""
        solved = self._solved(products)
        matrix = own - (products[:, :, self._known] * self._scale) @ solved
        data = self._scale * self._total[self._known, GramTerm.DATA]
        right = products[:, :, GramTerm.DATA] - data @ solved
        coefficients = (np.linalg.pinv(matrix, rcond=1e-9, hermitian=True) @ right[..., None])[..., 0]
        powers = np.einsum("nt,nt->n", right, coefficients)
        best = int(powers.argmax())
        known = (np.linalg.solve(self._normal, data) - solved[best] @ coefficients[best]) * self._scale
        # Where nothing is left to explain, rounding may be negative.
        return _Explanation(max(float(powers[best]), 0.0), coefficients[best], known, best)

    def variance_without(self, pattern: _Pattern) -> float:
        """Of a sample, once the pattern is taken out: as large as the pose scatters from stretch to stretch.

        Where a model is finer than the scan's rays, or lacks something, the residual is large just where the pose
        matters, and goes on from view to view. The pose that fits some views together shows it.
        """
        pose, found = POSE, pattern.found
        grams = self.grams[:, pose]
        scores = grams[:, :, GramTerm.DATA] - grams[:, :, self._known] @ found.known
        scores -= np.einsum("tk,kpt,t->kp", pattern.shapes, grams[:, :, pattern.which], found.coefficients)
        own = np.einsum("kpp->kp", grams[:, :, pose])
        remaining = project_out(self._total, self._known, [GramTerm.DATA])[0].item()
        variance = max(remaining - found.power, 0.0) / self._samples
        for stretches in STRETCHES:
            first = np.unique(np.linspace(0, len(grams), stretches, endpoint=False).astype(np.intp))
            power, expected = np.add.reduceat(scores, first) ** 2, np.add.reduceat(own, first)
            seen = expected > 1e-9 * expected.max(axis=0)
            variance = max(variance, float((power[seen] / expected[seen]).mean()))
        return variance

    def significance(self, pattern: _Pattern) -> float:
        """Of a pattern's coefficients c, V their covariance by the jackknife over the views: c' V^-1 c.

        What one view in which an edge lies along the rays makes of a coarse model is gone when that view is left out
        (Efron 1982; of linear regression, the cluster jackknife of Cameron and Miller 2015).
        """
        grams, terms, views = self.grams, len(pattern.which), len(self.grams)
        columns = [*pattern.which, *self._known]
        shapes = np.ones((views, len(columns)))
        shapes[:, :terms] = pattern.shapes.T
        normals = shapes[:, :, None] * shapes[:, None, :] * grams[:, columns][:, :, columns]
        rights = shapes * grams[:, columns, GramTerm.DATA]
        scale = 1.0 / np.sqrt(np.diag(normals.sum(axis=0)))
        normals *= np.outer(scale, scale)
        rights *= scale
        without_one = normals.sum(axis=0) - normals + REGULARISATION * np.eye(len(columns))
        found = np.linalg.solve(without_one, (rights.sum(axis=0) - rights)[..., None])[:, :terms, 0]
        coefficients = pattern.found.coefficients / scale[:terms]
        off = found - coefficients
        covariance = (views - 1) / views * off.T @ off
        return float(coefficients @ np.linalg.pinv(covariance, hermitian=True) @ coefficients)

    def in_parameters(self, pattern: _Pattern) -> FloatArray:
        """Its coefficients in radians and mm."""
        return pattern.found.coefficients / self._gain

    def bias_of(self, pattern: _Pattern) -> FloatArray:
        """The bias of the fit's seven unknowns, (7,), when a pattern is not modelled."""
        products, _ = self.shaped(pattern.which, pattern.shapes)
        moved = -(self._solved(products) @ pattern.found.coefficients) * self._scale
        bias = np.zeros(len(Parameter))
        bias[self._free] = moved[: len(self._free)] / self._gain
        return bias

    def _solved(self, products: FloatArray) -> FloatArray:
        """What the known terms make of added ones (..., terms, 10 or 13): (..., known, terms), of scaled terms."""
        cross = products[..., self._known] * self._scale
        return np.asarray(np.linalg.solve(self._normal, np.swapaxes(cross, -1, -2)), np.float64)


def _jump(residual: _ResidualPatterns) -> _Pattern:
    """Of the pose, from some view on."""
    pose, views = POSE, len(residual.grams)
    fewest = max(FEWEST_VIEWS, round(SHARE_OF_VIEWS * views))
    # Of the views from each on, the first and the last few left out.
    after = np.cumsum(residual.grams[::-1, pose], axis=0)[::-1][fewest : views - fewest + 1]
    found = residual.explained(after, after[:, :, pose])
    shape = (np.arange(views) >= fewest + found.trial).astype(np.float64)
    return _Pattern(Change.PHANTOM, pose, np.tile(shape, (3, 1)), found)


def _pace(residual: _ResidualPatterns) -> _Pattern:
    """Angles that run too fast or too slowly."""
    return _turning(residual, Change.PACE, (residual.angles - residual.angles.mean())[None])


def _swing(residual: _ResidualPatterns) -> _Pattern:
    """Angles that are ahead and behind once a turn."""
    return _turning(residual, Change.SWING, np.stack([np.cos(residual.angles), np.sin(residual.angles)]))


def _turning(residual: _ResidualPatterns, change: Change, shapes: FloatArray) -> _Pattern:
    which = [Parameter.PSI] * len(shapes)
    products, own = residual.shaped(which, shapes)
    return _Pattern(change, which, shapes, residual.explained(products[None], own[None]))


def _described(pattern: _Pattern, size: FloatArray, bias: FloatArray, radius_mm: float) -> Unsteadiness:
    """What a pattern of this size, in radians and mm, means for a phantom of this radius."""
    match pattern.change:
        case Change.PACE:
            return Unsteadiness(Change.PACE, bias, pace=1.0 + float(size[0]))
        case Change.SWING:
            return Unsteadiness(Change.SWING, bias, by_deg=math.degrees(math.hypot(*size)))
    turn, *move = size
    by_mm = math.hypot(*move)
    change = Change.ANGLES if by_mm < TURN_ALONE * abs(turn) * radius_mm else Change.PHANTOM
    view = int(pattern.shapes[0].argmax())
    return Unsteadiness(change, bias, by_deg=math.degrees(abs(turn)), by_mm=by_mm, view=view)
