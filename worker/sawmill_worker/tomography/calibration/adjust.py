"""What real scans are beyond the plain model: found, fitted and reported; nothing is done where nothing is wrong.

Outliers (dead and hot cells, corrupt views, edges within a cell) lose their weight; blur, beam hardening, a density
that slopes over the wood, and views with a gain or background of their own become terms of the model. Each term must
lower the residual by far more than chance and by a share that matters before it is taken in.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import correlate1d
from scipy.optimize import minimize_scalar

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.analytic import PARAMETERS, DetectorCells
from sawmill_worker.tomography.calibration.error_bars import Spread, parameter_spread
from sawmill_worker.tomography.calibration.fit import (
    DATA,
    MOMENTS,
    SQUARE,
    Fit,
    SinogramData,
    project_out,
    reduce,
    refine,
)
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.vocabulary import Adjustment

# In robust standard deviations: beyond it a sample loses weight.
OUTLIER = 4.0
# Rays over which a cell's intensities are averaged.
FINE_RAYS = 8
# The shadow proper, as a share of its depth.
SHADOW = 0.02
# Outliers are worth reweighting when they hold this share of the residual's power.
OUTLIER_POWER = 0.25
# They are a fault of the scan, and no model error, when cells or views of which such a part is outlying hold so much.
WHOLE, FAULT_SHARE = 0.2, 0.7
# A term is taken in when its chi-square per parameter exceeds this and it removes this share of the residual's power.
LEAST_CHI_SQUARE, LEAST_SHARE = 50.0, 0.02
# Hardening below this, on the longest path, is within what a drawing of the phantom may be wrong by.
LEAST_HARDENING = 0.005
# In cells, the Gaussian's standard deviation: less is lost in the averaging over the cell itself, more is no blur.
LEAST_BLUR, WIDEST_BLUR = 0.2, 8.0
BLUR_ROUNDS = 2
# A view strays whose neighbouring cells share so many times the others' residual power (median), if no more than this
# share of the views do.
STRAY, FEW_STRAYS, STRAY_ROUNDS = 3.0, 0.1, 3


@dataclass(frozen=True)
class Adjusted:
    """The fit after what was found in the scan, and one sentence for each thing done."""

    phantom: Phantom
    data: SinogramData
    fit: Fit
    done: tuple[str, ...] = ()

    def after(self, data: SinogramData, fit: Fit, told: str) -> "Adjusted":
        """What was done, told."""
        return Adjusted(self.phantom, data, fit, (*self.done, told))

    @cached_property
    def grams(self) -> FloatArray:
        """`analytic.gram` at the fit, every term beside the rest: (views, 13, 13)."""
        return self.data.gram(self.phantom, self.fit.to_vector(), self.fit.hardening, extended=True)

    @cached_property
    def spread(self) -> Spread:
        """How the residual makes the parameters scatter."""
        return parameter_spread(self.grams, self.data, self.fit)


def adjust(
    phantom: Phantom,
    data: SinogramData,
    fit: Fit,
    *,
    from_counts: bool = False,
    without: Collection[Adjustment] = (),
) -> Adjusted:
    """Go from the plain fit to the one that the scan asks for.

    Parameters
    ----------
    phantom, data, fit
        The plain model, the scan, and where its least squares ended.
    from_counts : bool
        Whether cells averaged intensities.
    without
        What is not to be looked for.
    """
    now = Adjusted(phantom, data, fit)
    if from_counts and Adjustment.INTENSITY_AVERAGING not in without:
        now = _paths_from_intensities(now)
    if Adjustment.OUTLIERS not in without:
        now = _without_outliers(now)
    now = _with_terms(now, without)
    if Adjustment.OUTLIERS not in without:
        now = _without_strays(now)
    if Adjustment.BLUR in without:
        return now
    sharp = _blur(now)
    return now if sharp is now else _with_terms(sharp, without)


def explained(phantom: Phantom, data: SinogramData, fit: Fit) -> FloatArray:
    """The model sinogram (views, cells) in the data's unit, every fitted term included."""
    given = (phantom, data.cells, fit.frame, data.angles_rad)
    if data.density_gradient:
        shadow, moments = analytic.project_with_moments(
            *given, position_mm=fit.position_mm, rays_per_cell=data.rays_per_cell
        )
        slope_x, slope_y = fit.gradient_per_mm
        shape = shadow + slope_x * moments[0] + slope_y * moments[1]
    else:
        shape = shadow = analytic.project(*given, position_mm=fit.position_mm, rays_per_cell=data.rays_per_cell)
    if data.hardening:
        shape = shape + fit.hardening * shadow**2
    if data.blur_cells > 0.0:
        taps = analytic.blur_taps(data.blur_cells)
        shape = correlate1d(shape, np.concatenate([taps[:0:-1], taps]), axis=1, mode="reflect")
    if not data.view_gain:
        common: FloatArray = fit.gain * shape + fit.offset
        return common
    weights = np.ones_like(shape) if data.weights is None else data.weights
    total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)  # a view left out has no level of its own: 0
    centre = (weights * shape).sum(axis=1, keepdims=True) / total
    level = (weights * data.sinogram).sum(axis=1, keepdims=True) / total
    power = (weights * (shape - centre) ** 2).sum(axis=1, keepdims=True)
    gains = (weights * (shape - centre) * data.sinogram).sum(axis=1, keepdims=True) / np.maximum(power, 1e-300)
    model: FloatArray = level + gains * (shape - centre)
    return model


def _paths_from_intensities(now: Adjusted) -> Adjusted:
    """A cell of counts holds -ln(mean(exp(-p))) over its rays where the model holds mean(p): add what is between.

    It is taken from the fit itself, and the fit repeated, twice: edges along the rays would pull the geometry.
    """
    if now.data.rays_per_cell == 1:  # a cell of one ray averages nothing
        return now
    cells = now.data.cells
    fine = DetectorCells(cells.first_border_mm, cells.width_mm / FINE_RAYS, cells.count * FINE_RAYS)
    data, fit = now.data, now.fit
    for _ in range(2):
        rays = analytic.project(
            now.phantom, fine, fit.frame, data.angles_rad, position_mm=fit.position_mm, rays_per_cell=1
        ).reshape(len(data.sinogram), cells.count, FINE_RAYS)
        rays *= fit.gain
        between = rays.mean(axis=2) + np.log(np.exp(-rays).mean(axis=2))
        data = replace(now.data, sinogram=now.data.sinogram + between)
        again = refine(now.phantom, data, fit.frame, position_mm=fit.position_mm)
        if again is None or not again.converged:
            return now
        fit = again
    return now.after(data, fit, "each cell's averaging of intensities was allowed for")


def _blur(now: Adjusted) -> Adjusted:
    """The focal spot and the scintillator blur along the detector: a Gaussian, its width found by least squares.

    The fit is repeated with it, and the width found again: the first one was beside a sharp fit.
    """
    data, fit = now.data, now.fit
    for number in range(BLUR_ROUNDS):
        model = explained(now.phantom, replace(data, blur_cells=0.0), fit)
        residual = data.sinogram - model
        if data.weights is not None:
            residual *= data.weights > 0.0
        width, share = _blur_width(model, residual)
        if number == 0 and (share * data.samples < LEAST_CHI_SQUARE or share < LEAST_SHARE or width < LEAST_BLUR):
            return now
        data = replace(data, blur_cells=width)
        again = refine(now.phantom, data, fit.frame, position_mm=fit.position_mm)
        if again is None or not again.converged or again.residual_rms >= now.fit.residual_rms:
            return now
        fit = again
    return now.after(data, fit, f"a blur of {data.blur_cells:.2f} detector cells (standard deviation) was fitted")


def _blur_width(model: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """The width in cells that explains most of a sharp model's residual (views, cells), and which share of its power.

    A cosine transform continues each view evenly beyond the detector's ends; there a blur is a factor.
    """
    sharp, left = dct(model, axis=1, norm="ortho"), dct(residual, axis=1, norm="ortho")
    power, cross, total = (sharp**2).sum(axis=0), (sharp * left).sum(axis=0), float((left**2).sum())
    frequency = np.pi * np.arange(power.size) / power.size

    def misfit(width: float) -> float:
        change = np.expm1(width**2 * (np.cos(frequency) - 1.0))
        return float((change * change * power - 2.0 * change * cross).sum())

    found = minimize_scalar(misfit, bounds=(0.0, WIDEST_BLUR), method="bounded", options={"xatol": 1e-3})
    return float(found.x), -float(found.fun) / total if total > 0.0 else 0.0


def _without_outliers(now: Adjusted) -> Adjusted:
    """Take weight from samples that the model cannot explain, twice: the first fit was still pulled by them."""
    data, fit = now.data, now.fit
    share = 0.0
    for _ in range(2):
        model = explained(now.phantom, data, fit)
        residual = data.sinogram - model
        # Air says nothing of the spread: it may be free of noise, and is the most of a sinogram.
        used = np.ones_like(residual) if now.data.weights is None else now.data.weights
        shadowed = residual[(model > fit.offset + SHADOW * float(np.ptp(model))) & (used > 0.0)]
        spread = 1.4826 * float(np.median(np.abs(shadowed - np.median(shadowed)))) if shadowed.size else 0.0
        # A phantom no truer than its size tolerance leaves that much by itself.
        spread = max(spread, now.phantom.size_tolerance * float(np.ptp(model)))
        if spread == 0.0:
            return now
        size = np.abs(residual) / spread
        outlying = size > OUTLIER
        power = used * np.where(outlying, residual, 0.0) ** 2
        if power.sum() < OUTLIER_POWER * (used * residual**2).sum() or not _of_a_fault(power, outlying):
            break
        weighted = replace(data, weights=used * np.where(outlying, (OUTLIER / size) ** 2, 1.0))
        again = refine(now.phantom, weighted, fit.frame, position_mm=fit.position_mm)
        if again is None or not again.converged:
            break
        data, fit, share = weighted, again, float(outlying[used > 0.0].mean())
    if share == 0.0:
        return now
    return now.after(data, fit, f"{share:.2%} of the samples are outliers and lost weight")


def _without_strays(now: Adjusted) -> Adjusted:
    """Leave out the few views that the others' fit does not explain: the body or the turntable was elsewhere.

    What is wrong with a drawing shows in all views, and at most three times as strongly in some.
    """
    data, fit = now.data, now.fit
    strays = np.zeros(len(data.sinogram), bool)
    for _ in range(STRAY_ROUNDS):
        weights = np.ones_like(data.sinogram) if data.weights is None else data.weights
        used = np.sqrt(weights) * (data.sinogram - explained(now.phantom, data, fit))
        # Noise, however strong in deep shadow, is not shared by neighbours; what a model lacks is.
        shared, power = (used[:, 1:] * used[:, :-1]).sum(axis=1), (used**2).sum(axis=1)
        found = shared > STRAY * np.median(power[power > 0.0])
        if not found.any() or (strays | found).sum() > FEW_STRAYS * len(strays):
            break
        left = replace(data, weights=np.where(found[:, None], 0.0, weights))
        again = refine(now.phantom, left, fit.frame, position_mm=fit.position_mm)
        if again is None or not again.converged:
            break
        data, fit, strays = left, again, strays | found
    if not strays.any():
        return now
    return now.after(data, fit, f"{int(strays.sum())} views that do not fit the others were left out")


def _of_a_fault(power: FloatArray, outlying: NDArray[np.bool_]) -> bool:
    """Whether outliers are whole cells' or whole views', as faults are; elsewhere the model is not the scan's."""
    cells = power[:, outlying.mean(axis=0) > WHOLE].sum()
    views = power[outlying.mean(axis=1) > WHOLE].sum()
    return bool(max(cells, views) > FAULT_SHARE * power.sum())


def _gain_of(now: Adjusted, extras: list[int], *, view_gain: bool) -> tuple[float, float]:
    """Chi-square and share of the residual's power that more linear terms would take away, to first order."""
    kept = [*range(PARAMETERS), DATA]

    def remaining(terms: list[int], *, by_view: bool) -> float:
        schur, _ = reduce(now.grams, terms, kept, view_gain=by_view)
        return float(project_out(schur, list(range(PARAMETERS)), [PARAMETERS])[0][0, 0])

    try:
        before = remaining(now.data.extras, by_view=now.data.view_gain)
        after = remaining([*now.data.extras, *extras], by_view=now.data.view_gain or view_gain)
    except np.linalg.LinAlgError:  # the scan does not determine the geometry as it is: more terms cannot be judged
        return 0.0, 0.0
    if not (math.isfinite(before) and before > 0.0):
        return 0.0, 0.0
    share = max(before - after, 0.0) / before
    return share * now.data.samples / now.spread.inflation, share


def _refitted(now: Adjusted, data: SinogramData, told: str) -> Adjusted | None:
    fit = refine(now.phantom, data, now.fit.frame, position_mm=now.fit.position_mm)
    if fit is None or fit.relative_residual >= now.fit.relative_residual:
        return None
    return now.after(data, fit, told)


def _with_terms(now: Adjusted, without: Collection[Adjustment]) -> Adjusted:
    """Take in the linear terms that are worth it, each time the one that explains most: they resemble each other."""
    terms = {
        Adjustment.VIEW_GAIN: (now.data.view_gain, _view_gain_share, _view_gain),
        Adjustment.BEAM_HARDENING: (now.data.hardening, _hardening_share, _hardening),
        Adjustment.DENSITY_GRADIENT: (now.data.density_gradient, _gradient_share, _gradient),
    }
    waiting = [(share, take) for name, (taken, share, take) in terms.items() if not taken and name not in without]
    while waiting:
        shares = [share(now) for share, _ in waiting]
        best = int(np.argmax(shares))
        if shares[best] == 0.0:
            break
        now = waiting.pop(best)[1](now)
    return now


def _view_gain_share(now: Adjusted) -> float:
    """Of the residual's power that it takes away; 0 where that is not worth it, as with the others."""
    views = len(now.data.sinogram)
    chi_square, share = _gain_of(now, [], view_gain=True)
    # Two terms a view always take away two samples' worth a view.
    chance = 4.0 * views / now.data.sinogram.size
    return share if chi_square >= 2.0 * (2.0 * views) and share >= LEAST_SHARE + chance else 0.0


def _view_gain(now: Adjusted) -> Adjusted:
    told = "the views differ in gain or background: each was fitted with its own"
    return _refitted(now, replace(now.data, view_gain=True), told) or now


def _hardening_share(now: Adjusted) -> float:
    chi_square, share = _gain_of(now, [SQUARE], view_gain=False)
    return share if chi_square >= LEAST_CHI_SQUARE and share >= LEAST_SHARE else 0.0


def _hardening(now: Adjusted) -> Adjusted:
    after = _refitted(now, replace(now.data, hardening=True), "")
    if after is None:
        return now
    longest = float(analytic.project(now.phantom, now.data.cells, after.fit.frame, now.data.angles_rad).max())
    if abs(after.fit.hardening * longest) < LEAST_HARDENING:
        return now
    told = f"beam hardening of {after.fit.hardening * longest:+.1%} on the longest path was fitted"
    return now.after(after.data, after.fit, told)


def _gradient_share(now: Adjusted) -> float:
    chi_square, share = _gain_of(now, [*MOMENTS], view_gain=False)
    return share if chi_square >= 2.0 * LEAST_CHI_SQUARE and share >= LEAST_SHARE else 0.0


def _gradient(now: Adjusted) -> Adjusted:
    after = _refitted(now, replace(now.data, density_gradient=True), "")
    if after is None:
        return now
    slope = math.hypot(*after.fit.gradient_per_mm) * 100.0
    return now.after(after.data, after.fit, f"the wood's density slopes by {slope:.1%} in 100 mm, which was fitted")
