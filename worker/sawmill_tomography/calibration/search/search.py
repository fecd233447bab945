"""The multi-start search: initial guesses, and ambiguous poses, are fitted until one fit explains the scan."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.calibration.alternatives import CONTENDER
from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress, refine
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.calibration.search.misfit import (
    Candidate,
    CoarseMisfit,
    coarse_data,
    random_guesses,
    search_box,
    shadow_extent,
    shadow_guesses,
)
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, SourceFrame, wrap_angle
from sawmill_tomography.projection import analytic
from sawmill_vocabulary import Handedness

# A coarse fit that leaves less than the share EXPLAINED of the sinogram ends the search. Otherwise random guesses are
# added, in rounds of these sizes.
EXPLAINED = 0.05
RANDOM_GUESSES = (64, 256)
# Number of guesses of each hypothesis that are fitted, and iterations of each fit: the fit to all the data does the
# rest.
GUESSES_FITTED = 2
COARSE_ITERATIONS = 20

# Receives the round of the search, the largest number of rounds, and the least relative residual so far.
SearchCallback = Callable[[int, int, float], None]


@dataclass(frozen=True)
class SearchReport:
    """Report on the search."""

    method: str
    seed: int
    evaluations: int
    generations: int
    best_value: float  # best value of the objective
    converged: bool
    message: str
    history: tuple[tuple[int, float], ...] = ()

    @staticmethod
    def note(history: list[tuple[int, float]], evaluations: int, value: float) -> None:
        """Add a value to a growing history, if the value is better than all earlier values."""
        if not history or value < history[-1][1]:
            history.append((evaluations, value))


@dataclass(frozen=True)
class SearchResult:
    """Coarse fits of each hypothesis, best first: the starting points of least squares on all the data."""

    fits: Mapping[PoseHypothesis, Sequence[Fit]]
    report: SearchReport


def search(
    task: CalibrationTask, seed: int, on_round: SearchCallback | None = None, on_step: OnStep = ignore_progress
) -> SearchResult:
    """Make coarse fits of each hypothesis, adding guesses until a fit explains the scan."""
    rng = np.random.default_rng(seed)
    misfit = coarse_misfit(task)
    box = geometry_box(task)
    fits: dict[PoseHypothesis, Fit] = {}
    history: list[tuple[int, float]] = []
    best, generation = math.inf, 0
    for generation, count in enumerate((0, *RANDOM_GUESSES)):
        guesses = random_guesses(box, count, rng) if count else guesses_from_shadow(misfit, task, box, rng)
        _improve(fits, misfit, guesses, history, on_step)
        best = _least(fits.values())
        if on_round is not None:
            on_round(generation + 1, len(RANDOM_GUESSES) + 1, best)
        if best < EXPLAINED:
            break
    explained = best < EXPLAINED
    message = (
        f"an initial guess explains {1.0 - best:.1%} of the scan"
        if explained
        else "no initial guess explains the scan well"
    )
    report = SearchReport(
        "multi-start", seed, misfit.evaluations, generation + 1, best, explained, message, tuple(history)
    )
    return SearchResult(_with_ambiguous_poses(fits, misfit, on_step), report)


def coarse_misfit(task: CalibrationTask) -> CoarseMisfit:
    """Return the misfit of a task's coarse sinogram, without views that are not usable."""
    usable = task.screening
    bridged = usable.bridged(task.sinogram)[usable.views]
    sinogram, angles, cells = coarse_data(task.scanner, bridged, task.angles_rad[usable.views])
    return CoarseMisfit(task.phantoms, task.rotations, sinogram, angles, cells)


def geometry_box(task: CalibrationTask) -> FloatArray:
    """Return the ranges (4, 2) of (R, ln M, u_c, tau) in which a task's geometry is searched."""
    try:
        return search_box(task.scanner, task.bounds, task.phantom)
    except GeometryError as error:
        raise CalibrationError("no-geometry", str(error)) from error


def guesses_from_shadow(
    misfit: CoarseMisfit, task: CalibrationTask, box: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return guesses (guesses, 4) of (R, ln M, u_c, tau) that cast the measured shadow; none without a shadow."""
    extent = shadow_extent(misfit.sinogram, misfit.cells)
    if extent is None:
        return np.zeros((0, 4))
    return shadow_guesses(extent, task.phantom.radius_mm, (float(box[0, 0]), float(box[0, 1])), rng)


def _improve(
    fits: dict[PoseHypothesis, Fit],
    misfit: CoarseMisfit,
    guesses: FloatArray,
    history: list[tuple[int, float]],
    on_step: OnStep,
) -> None:
    """Fit the best guesses of each hypothesis coarsely, and keep each fit that is better than the last."""
    scored: dict[PoseHypothesis, list[Candidate]] = {}
    for guess in guesses:
        on_step()
        for hypothesis, candidate in misfit(guess).items():
            scored.setdefault(hypothesis, []).append(candidate)
            SearchReport.note(history, misfit.evaluations, candidate.relative_residual)
    chosen = [
        (hypothesis, candidate)
        for hypothesis, candidates in scored.items()
        for candidate in sorted(candidates, key=lambda c: c.misfit)[:GUESSES_FITTED]
    ]
    for hypothesis, candidate in sorted(chosen, key=lambda pair: pair[1].misfit):
        # After a fit explains the scan, one guess of each other hypothesis is enough.
        if hypothesis in fits and _least(fits.values()) < EXPLAINED:
            continue
        fit = _coarse_fit(misfit, hypothesis, candidate.frame, (0.0, 0.0), fits.values(), on_step)
        before = fits.get(hypothesis)
        if fit is not None and (before is None or fit.relative_residual < before.relative_residual):
            fits[hypothesis] = fit
            SearchReport.note(history, misfit.evaluations, fit.relative_residual)


def _least(fits: Collection[Fit]) -> float:
    return min((fit.relative_residual for fit in fits), default=math.inf)


def _coarse_fit(
    misfit: CoarseMisfit,
    hypothesis: PoseHypothesis,
    start: SourceFrame,
    position_mm: tuple[float, float],
    fits: Collection[Fit],
    on_step: OnStep,
) -> Fit | None:
    """Fit a guess to the coarse sinogram, as long as the guess may compete with the best of these fits."""
    least = _least(fits)
    return refine(
        misfit.phantoms[hypothesis.handedness],
        SinogramData(misfit.sinogram, hypothesis.rotation.apply(misfit.angles_rad), misfit.cells),
        start,
        position_mm=position_mm,
        max_iterations=COARSE_ITERATIONS,
        hopeless=CONTENDER * least if least < EXPLAINED else math.inf,
        on_step=on_step,
    )


def _with_ambiguous_poses(
    coarse: dict[PoseHypothesis, Fit], misfit: CoarseMisfit, on_step: OnStep
) -> dict[PoseHypothesis, list[Fit]]:
    """Add fits that start from poses in which the best fit's body looks almost the same."""
    fits = {hypothesis: [fit] for hypothesis, fit in coarse.items()}
    if not fits:
        return fits
    best = min(coarse, key=lambda hypothesis: coarse[hypothesis].relative_residual)
    fit = coarse[best]
    for handedness, frame, position in ambiguous_poses(misfit, best, fit.frame, fit.position_mm):
        hypothesis = PoseHypothesis(handedness, best.rotation)
        other = _coarse_fit(misfit, hypothesis, frame, position, [fit], on_step)
        if other is not None:
            rivals = fits.setdefault(hypothesis, [])
            rivals.append(other)
            rivals.sort(key=lambda fit: fit.relative_residual)
    return fits


# Peaks of the correlation over the first angle that are fitted.
PEAKS = 4

# The handedness, the geometry with the turned first angle, and the phantom's position (x, y) in mm.
Pose = tuple[Handedness, SourceFrame, tuple[float, float]]


def ambiguous_poses(
    misfit: CoarseMisfit, hypothesis: PoseHypothesis, at: SourceFrame, position_mm: tuple[float, float]
) -> list[Pose]:
    """Find the poses at which the correlation of projection and scan has another peak than the fit's.

    In each pose the centroid stays at its place in the fit, which `at` and `position_mm` give.
    """
    angles, turns = hypothesis.rotation.apply(misfit.angles_rad), misfit.table_rad[::2]
    data = misfit.sinogram.ravel() - misfit.sinogram.mean()
    centroid = complex(*misfit.phantoms[hypothesis.handedness].centroid_mm) + complex(*position_mm)
    poses: list[Pose] = []
    for other, phantom in misfit.phantoms.items():
        places = np.exp(1j * turns) * centroid - complex(*phantom.centroid_mm)
        clear = [analytic.clears(phantom.radius_mm + abs(place), at) for place in places.tolist()]
        # All turns are projected in one call, like views.
        where = np.repeat(places[clear], angles.size)
        views = np.add.outer(turns[clear], angles).ravel()
        model = analytic.project(phantom, misfit.cells, at, views, position_mm=np.stack([where.real, where.imag], -1))
        model = model.reshape(-1, data.size)
        model -= model.mean(axis=1, keepdims=True)
        spread = np.linalg.norm(model, axis=1) * np.linalg.norm(data)
        correlation = np.full(turns.size, -1.0)
        # A pose that casts no shadow in any view has no correlation.
        correlation[clear] = np.divide(
            np.einsum("tm,m->t", model, data), spread, out=np.full(spread.size, -1.0), where=spread > 0.0
        )
        peak = (correlation > np.roll(correlation, 1)) & (correlation >= np.roll(correlation, -1))
        if other is hypothesis.handedness:
            peak[0] = False  # the fit itself
        for index in sorted(np.flatnonzero(peak), key=lambda index: -correlation[index])[:PEAKS]:
            frame = replace(at, psi_rad=wrap_angle(at.psi_rad + float(turns[index])))
            poses.append((other, frame, (places[index].real, places[index].imag)))
    return poses
