"""The calibration that users get: a search for the basin, least squares to its minimum, over the four hypotheses."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sawmill_worker.tomography.calibration.adjust import Adjusted, adjust, explained
from sawmill_worker.tomography.calibration.calibration import (
    Calibration,
    HypothesisReport,
    choose_theta,
    theta_covariance,
)
from sawmill_worker.tomography.calibration.errors import CalibrationError
from sawmill_worker.tomography.calibration.fit import Fit, SinogramData, refine
from sawmill_worker.tomography.calibration.judgement import TurnedRival, judge
from sawmill_worker.tomography.calibration.refusals import refuse_unfound
from sawmill_worker.tomography.calibration.search import SearchCallback, SearchResult, search
from sawmill_worker.tomography.calibration.structure import find_structure
from sawmill_worker.tomography.calibration.task import CalibrationTask, Hypothesis
from sawmill_worker.tomography.calibration.unsteadiness import find_unsteadiness
from sawmill_worker.tomography.geometry import angle_difference
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.tomography.ray_error import predicted_ray_error, scale_ray_error

# A sinogram with less than this share of its power above white noise shows nothing.
LEAST_SIGNAL = 0.02
# Hypotheses whose coarse residual comes this close to the best one's are fitted on all the data and compared again.
CONTENDER = 3.0
# Fits whose first angles differ by less are the same one.
SAME_TURN = math.radians(5.0)
FINE_ITERATIONS = 60


def calibrate(task: CalibrationTask, *, seed: int = 7, progress: SearchCallback | None = None) -> Calibration:
    """Find the geometry from one scan of the phantom.

    Raises
    ------
    CalibrationError
        If no geometry explains the scan; its message says what to look at.
    """
    started = time.perf_counter()
    found = search(task, seed, progress)
    return conclude(task, found, started=started, searched=time.perf_counter())


def conclude(
    task: CalibrationTask,
    basins: SearchResult,
    *,
    started: float,
    searched: float,
) -> Calibration:
    """From the coarse fits to the complete answer."""
    ranked = _full_fits(task, basins.fits)
    refuse_unfound(
        task.scanner,
        task.phantom,
        ranked[0][1] if ranked else None,
        _unexplained(task, ranked[0]) if ranked else 1.0,
    )
    (handedness, rotation), free = ranked[0]
    phantom, data = task.phantoms[handedness], task.full_data(rotation)
    adjusted = adjust(phantom, data, free, from_counts=task.from_counts, without=task.without)
    data, free = adjusted.data, adjusted.fit
    fit, fixed = _with_theta(task, phantom, data, free)
    refined = time.perf_counter()
    explained_part = explained(phantom, data, fit)
    residual = data.sinogram - explained_part
    held = replace(adjusted, fit=fit) if fixed else adjusted
    spread = held.spread
    usable = residual * (1.0 if data.weights is None else data.weights > 0.0)
    unsteady = None
    if spread.turn_held:
        unsteady = find_unsteadiness(phantom, data, fit, held.grams, usable, explained_part)
    bias = np.zeros(5) if unsteady is None else unsteady.bias[:5]
    covariance = spread.covariance[:5, :5] + np.outer(bias, bias)
    theta, twin = choose_theta(task.scanner, fit.frame, task.bounds)
    predicted = predicted_ray_error(task.scanner, fit.frame, covariance, radius_mm=task.log_radius_mm)
    hypotheses, turned_rival = _rivals(ranked)
    of_theta = theta_covariance(task.scanner, fit.frame, theta, covariance)
    source_shift_resolved = of_theta is not None
    if not spread.turn_held:  # nothing is known of psi, and so nothing of the first angle
        covariance[0, :] = covariance[:, 0] = 0.0
        of_theta = None
    scale_mm = scale_ray_error(task.scanner, fit.frame, task.phantom.size_tolerance, radius_mm=task.log_radius_mm)
    judged = judge(
        predicted=predicted,
        tolerance_mm=task.tolerance_mm,
        fit=fit,
        inflation=spread.inflation,
        widening=spread.widening,
        structure=find_structure(usable, explained_part) if spread.structured else None,
        unsteady=unsteady,
        unsteady_mm=0.0
        if unsteady is None
        else predicted_ray_error(task.scanner, fit.frame, np.outer(bias, bias), radius_mm=task.log_radius_mm).rms_mm,
        hypotheses=hypotheses,
        turned=turned_rival,
        turn_held=spread.turn_held,
        samples=data.sinogram.size,
        source_shift_resolved=source_shift_resolved,
        theta_in_bounds=task.bounds is None or task.bounds.contain(theta),
        unconstrained_mm=free.frame.source_distance_mm if fixed else None,
        short_of_deviations=_short_of(task, adjusted) if fixed else 0.0,
        source_to_cor_mm=task.scanner.source_to_cor_mm,
        scale_ray_error_mm=scale_mm,
    )
    ended = time.perf_counter()
    return Calibration(
        scanner=task.scanner,
        phantom=task.phantom,
        frame=fit.frame,
        theta=theta,
        theta_twin=twin,
        covariance=covariance,
        theta_covariance=of_theta,
        source_distance_fixed=fixed,
        unconstrained_source_distance_mm=free.frame.source_distance_mm,
        scale_uncertainty_mm=task.phantom.size_tolerance * fit.frame.source_distance_mm,
        scale_ray_error_mm=scale_mm,
        predicted_ray_error=predicted,
        log_radius_mm=task.log_radius_mm,
        inflation=spread.inflation,
        handedness=handedness,
        rotation=rotation,
        hypotheses=hypotheses,
        position_mm=fit.position_mm,
        gain=fit.gain,
        offset=fit.offset,
        residual_rms=fit.residual_rms,
        relative_residual=fit.relative_residual,
        model=task.sinogram - residual,
        residual=residual,
        adjustments=(*task.screening.done, *adjusted.done),
        status=judged.status,
        verdict=judged.verdict,
        reasons=judged.reasons,
        search=basins.report,
        seconds={
            "total": ended - started,
            "search": searched - started,
            "refine": refined - searched,
            "uncertainty": ended - refined,
        },
    )


def _short_of(task: CalibrationTask, free: Adjusted) -> float:
    """By how many standard deviations, the stated size's included, the free source distance falls short of r_S."""
    distance = free.fit.frame.source_distance_mm
    deviation = math.hypot(math.sqrt(float(free.spread.covariance[1, 1])), task.phantom.size_tolerance * distance)
    short = task.scanner.source_to_cor_mm - distance
    return short / deviation if deviation > 0.0 else math.inf


def _unexplained(task: CalibrationTask, best: tuple[Hypothesis, Fit]) -> float:
    """The share of the sinogram that the best fit leaves, white noise not counted."""
    (handedness, rotation), fit = best
    data = task.full_data(rotation)
    residual = data.sinogram - explained(task.phantoms[handedness], data, fit)
    # Neighbouring cells share what the model lacks; what they do not share is noise.
    steps = np.diff(residual, axis=1)
    noise = 1.4826 * float(np.median(np.abs(steps))) / math.sqrt(2.0)
    total = fit.residual_rms**2 / fit.relative_residual**2 if fit.relative_residual > 0.0 else math.inf
    signal = total - noise**2
    if signal < LEAST_SIGNAL * total:
        return 1.0
    return math.sqrt(max(fit.residual_rms**2 - noise**2, 0.0) / signal)


def _rivals(ranked: list[tuple[Hypothesis, Fit]]) -> tuple[tuple[HypothesisReport, ...], TurnedRival | None]:
    """Each hypothesis once, best first; and, if the winner's rival is itself turned, by how many degrees."""
    reports: dict[Hypothesis, HypothesisReport] = {}
    for hypothesis, fit in ranked:
        reports.setdefault(hypothesis, HypothesisReport(*hypothesis, fit.relative_residual))
    turned = [fit for hypothesis, fit in ranked[1:] if hypothesis == ranked[0][0]]
    if not turned:
        return tuple(reports.values()), None
    rival = TurnedRival(math.degrees(_apart(ranked[0][1], turned[0])), turned[0].relative_residual)
    return tuple(reports.values()), rival


def _full_fits(task: CalibrationTask, coarse: Mapping[Hypothesis, Sequence[Fit]]) -> list[tuple[Hypothesis, Fit]]:
    """Fit on all the data what may have won, measure there what cannot; best first, one a first angle."""
    least = min((fit.relative_residual for fits in coarse.values() for fit in fits), default=0.0)
    fitted: list[tuple[Hypothesis, Fit]] = []
    for hypothesis, starts in coarse.items():
        handedness, rotation = hypothesis
        data = task.full_data(rotation)
        for number, start in enumerate(starts):
            contends = start.relative_residual <= CONTENDER * least
            if number > 0 and not contends:
                continue
            # The coarse residual has its noise averaged away: what cannot win is still measured on all the data.
            fit = refine(
                task.phantoms[handedness],
                data,
                start.frame,
                position_mm=start.position_mm,
                max_iterations=FINE_ITERATIONS if contends else 1,
            )
            if fit is not None:
                fitted.append((hypothesis, fit))
    ranked: list[tuple[Hypothesis, Fit]] = []
    for hypothesis, fit in sorted(fitted, key=lambda item: item[1].relative_residual):
        if all(hypothesis != other or _apart(fit, better) > SAME_TURN for other, better in ranked):
            ranked.append((hypothesis, fit))
    return ranked


def _apart(a: Fit, b: Fit) -> float:
    return abs(angle_difference(a.frame.psi_rad, b.frame.psi_rad))


def _with_theta(task: CalibrationTask, phantom: Phantom, data: SinogramData, fit: Fit) -> tuple[Fit, bool]:
    """The fit itself, or the one with R = r_S where the free one has no theta (design page, section 3)."""
    r_s = task.scanner.source_to_cor_mm
    if fit.frame.source_distance_mm >= r_s:
        return fit, False
    ratio = r_s / fit.frame.source_distance_mm
    frame = fit.frame
    start = replace(frame, source_distance_mm=r_s, source_to_detector_mm=frame.source_to_detector_mm * ratio)
    held = refine(phantom, data, start, position_mm=fit.position_mm, fixed_source_distance=True)
    if held is None:
        raise CalibrationError(
            "no-geometry",
            f"the scan asks for a source at {fit.frame.source_distance_mm:.4g} mm, nearer than source_to_cor_mm "
            f"{r_s:.6g}: check source_to_cor_mm and the phantom's size",
        )
    return held, True
