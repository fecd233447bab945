"""What real scans are beyond the plain model: found, fitted and reported; nothing is done where nothing is wrong.

Outliers (dead and hot cells, corrupt views, edges within a cell) lose their weight; beam hardening, a density that
slopes over the wood, and views with a gain or background of their own become terms of the model. Each term must lower
the residual by far more than chance and by a share that matters before it is taken in.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worker.tomography import analytic
from worker.tomography.analytic import PARAMETERS, DetectorCells
from worker.tomography.calibration.refine import (
    DATA,
    MOMENTS,
    SQUARE,
    Fit,
    SinogramData,
    project_out,
    reduce,
    refine,
)
from worker.tomography.calibration.uncertainty import residual_inflation
from worker.tomography.geometry import FloatArray
from worker.tomography.phantom import Phantom

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


@dataclass(frozen=True)
class Adjusted:
    """The fit after what was found in the scan, and one sentence for each thing done."""

    data: SinogramData
    fit: Fit
    done: tuple[str, ...] = ()


def adjust(phantom: Phantom, data: SinogramData, fit: Fit, *, from_counts: bool = False) -> Adjusted:
    """Go from the plain fit to the one that the scan asks for; `from_counts` says that cells averaged intensities."""
    now = Adjusted(data, fit)
    if from_counts:
        now = _paths_from_intensities(phantom, now)
    now = _without_outliers(phantom, now)
    for find in (_view_gain, _hardening, _gradient):
        now = find(phantom, now)
    return now


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
    if not data.view_gain:
        common: FloatArray = fit.gain * shape + fit.offset
        return common
    weights = np.ones_like(shape) if data.weights is None else data.weights
    total = weights.sum(axis=1, keepdims=True)
    centre = (weights * shape).sum(axis=1, keepdims=True) / total
    level = (weights * data.sinogram).sum(axis=1, keepdims=True) / total
    power = (weights * (shape - centre) ** 2).sum(axis=1, keepdims=True)
    gains = (weights * (shape - centre) * data.sinogram).sum(axis=1, keepdims=True) / np.maximum(power, 1e-300)
    model: FloatArray = level + gains * (shape - centre)
    return model


def _paths_from_intensities(phantom: Phantom, now: Adjusted) -> Adjusted:
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
            phantom, fine, fit.frame, data.angles_rad, position_mm=fit.position_mm, rays_per_cell=1
        ).reshape(len(data.sinogram), cells.count, FINE_RAYS)
        rays *= fit.gain
        between = rays.mean(axis=2) + np.log(np.exp(-rays).mean(axis=2))
        data = replace(now.data, sinogram=now.data.sinogram + between)
        again = refine(phantom, data, fit.frame, position_mm=fit.position_mm)
        if again is None or not again.converged:
            return now
        fit = again
    return Adjusted(data, fit, (*now.done, "each cell's averaging of intensities was allowed for"))


def _without_outliers(phantom: Phantom, now: Adjusted) -> Adjusted:
    """Take weight from samples that the model cannot explain, twice: the first fit was still pulled by them."""
    data, fit = now.data, now.fit
    share = 0.0
    for _ in range(2):
        model = explained(phantom, data, fit)
        residual = data.sinogram - model
        # Air says nothing of the spread: it may be free of noise, and is the most of a sinogram.
        used = np.ones_like(residual) if now.data.weights is None else now.data.weights
        shadowed = residual[(model > fit.offset + SHADOW * float(np.ptp(model))) & (used > 0.0)]
        spread = 1.4826 * float(np.median(np.abs(shadowed - np.median(shadowed)))) if shadowed.size else 0.0
        # A phantom no truer than its size tolerance leaves that much by itself.
        spread = max(spread, phantom.size_tolerance * float(np.ptp(model)))
        if spread == 0.0:
            return now
        size = np.abs(residual) / spread
        outlying = size > OUTLIER
        power = used * np.where(outlying, residual, 0.0) ** 2
        if power.sum() < OUTLIER_POWER * (used * residual**2).sum() or not _of_a_fault(power, outlying):
            break
        weighted = replace(data, weights=used * np.where(outlying, (OUTLIER / size) ** 2, 1.0))
        again = refine(phantom, weighted, fit.frame, position_mm=fit.position_mm)
        if again is None or not again.converged:
            break
        data, fit, share = weighted, again, float(outlying[used > 0.0].mean())
    if share == 0.0:
        return now
    return Adjusted(data, fit, (*now.done, f"{share:.2%} of the samples are outliers and lost weight"))


def _of_a_fault(power: FloatArray, outlying: NDArray[np.bool_]) -> bool:
    """Whether outliers are whole cells' or whole views', as faults are; elsewhere the model is not the scan's."""
    cells = power[:, outlying.mean(axis=0) > WHOLE].sum()
    views = power[outlying.mean(axis=1) > WHOLE].sum()
    return bool(max(cells, views) > FAULT_SHARE * power.sum())


def _gain_of(phantom: Phantom, now: Adjusted, extras: list[int], *, view_gain: bool) -> tuple[float, float]:
    """Chi-square and share of the residual's power that more linear terms would take away, to first order."""
    grams = now.data.gram(phantom, now.fit.to_vector(), now.fit.hardening, extended=True)
    kept = [*range(PARAMETERS), DATA]

    def remaining(terms: list[int], *, by_view: bool) -> float:
        schur, _ = reduce(grams, terms, kept, view_gain=by_view)
        return float(project_out(schur, list(range(PARAMETERS)), [PARAMETERS])[0][0, 0])

    try:
        before = remaining(now.data.extras, by_view=now.data.view_gain)
        after = remaining([*now.data.extras, *extras], by_view=now.data.view_gain or view_gain)
    except np.linalg.LinAlgError:  # the scan does not determine the geometry as it is: more terms cannot be judged
        return 0.0, 0.0
    if not (math.isfinite(before) and before > 0.0):
        return 0.0, 0.0
    samples = now.data.sinogram.size if now.data.weights is None else float(now.data.weights.sum())
    share = max(before - after, 0.0) / before
    return share * samples / residual_inflation(phantom, now.data, now.fit), share


def _refitted(phantom: Phantom, now: Adjusted, data: SinogramData, told: str) -> Adjusted | None:
    fit = refine(phantom, data, now.fit.frame, position_mm=now.fit.position_mm)
    if fit is None or fit.relative_residual >= now.fit.relative_residual:
        return None
    return Adjusted(data, fit, (*now.done, told))


def _view_gain(phantom: Phantom, now: Adjusted) -> Adjusted:
    views = len(now.data.sinogram)
    chi_square, share = _gain_of(phantom, now, [], view_gain=True)
    # Two terms a view always take away two samples' worth a view.
    if chi_square < 2.0 * (2.0 * views) or share < LEAST_SHARE + 4.0 * views / now.data.sinogram.size:
        return now
    told = "the views differ in gain or background: each was fitted with its own"
    return _refitted(phantom, now, replace(now.data, view_gain=True), told) or now


def _hardening(phantom: Phantom, now: Adjusted) -> Adjusted:
    chi_square, share = _gain_of(phantom, now, [SQUARE], view_gain=False)
    if chi_square < LEAST_CHI_SQUARE or share < LEAST_SHARE:
        return now
    after = _refitted(phantom, now, replace(now.data, hardening=True), "")
    if after is None:
        return now
    longest = float(analytic.project(phantom, now.data.cells, after.fit.frame, now.data.angles_rad).max())
    if abs(after.fit.hardening * longest) < LEAST_HARDENING:
        return now
    told = f"beam hardening of {after.fit.hardening * longest:+.1%} on the longest path was fitted"
    return replace(after, done=(*now.done, told))


def _gradient(phantom: Phantom, now: Adjusted) -> Adjusted:
    chi_square, share = _gain_of(phantom, now, [*MOMENTS], view_gain=False)
    if chi_square < 2.0 * LEAST_CHI_SQUARE or share < LEAST_SHARE:
        return now
    after = _refitted(phantom, now, replace(now.data, density_gradient=True), "")
    if after is None:
        return now
    slope = math.hypot(*after.fit.gradient_per_mm) * 100.0
    told = f"the wood's density slopes by {slope:.1%} in 100 mm, which was fitted"
    return replace(after, done=(*now.done, told))
