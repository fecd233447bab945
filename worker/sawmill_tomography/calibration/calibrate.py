"""The default calibration: search, fit, angles, joint fit, residual, error bars, alternatives, judgement."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sawmill_tomography.calibration.alternatives import (
    Alternatives,
    RankedFit,
    alternatives_of,
    by_hypothesis,
    fit_hypotheses,
)
from sawmill_tomography.calibration.calibration import CalibrationOutcome, StageSeconds, choose_theta
from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress
from sawmill_tomography.calibration.joint_fit.effects import DEFORMATION
from sawmill_tomography.calibration.joint_fit.finding import WELL_EXPLAINED, AdjustedFit, EffectFinding, KnownEffect
from sawmill_tomography.calibration.joint_fit.intensity_averaging import INTENSITY_AVERAGING
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit, as_fit
from sawmill_tomography.calibration.joint_fit.metal import PhantomMetal, find_metal
from sawmill_tomography.calibration.joint_fit.outliers import OUTLIERS
from sawmill_tomography.calibration.joint_fit.residual_analysis import analyse_residual
from sawmill_tomography.calibration.joint_fit.residual_statistics import error_bars
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, Term
from sawmill_tomography.calibration.joint_fit.view_errors import view_errors
from sawmill_tomography.calibration.judgement import Evidence, JudgementLimits, judge
from sawmill_tomography.calibration.lost_views import shown_angles
from sawmill_tomography.calibration.refusals import CalibrationError, refuse_unfound
from sawmill_tomography.calibration.scale import scale_uncertainty
from sawmill_tomography.calibration.search.search import EXPLAINED, SearchCallback, SearchResult, search
from sawmill_tomography.calibration.source_distance import with_theta
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.phantoms.built_in import BUILT_IN
from sawmill_tomography.sinograms.scattered_radiation import fit_hardening, fit_scatter_and_hardening
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection

# Faults of a scan that are handled before the effects are fitted with the geometry.
BEFORE: tuple[EffectFinding, ...] = (INTENSITY_AVERAGING, OUTLIERS)


def calibrate(
    task: CalibrationTask, *, seed: int = 7, progress: SearchCallback | None = None, on_step: OnStep = ignore_progress
) -> CalibrationOutcome:
    """Find the geometry from one scan of the phantom.

    Parameters
    ----------
    progress : callable, optional
        Called after each round of the search.
    on_step : callable
        Called at each step of the search and of the fits after it.

    Raises
    ------
    CalibrationError
        If no geometry explains the scan; the message tells what to check.
    """
    started = time.perf_counter()
    basins = search(task, seed, progress, on_step)
    if not basins.report.converged or task.screening.hidden is not None:
        screened, _ = _without_metal(task, basins.fits, on_step)
        if screened is not task:
            task, basins = screened, search(screened, seed, progress, on_step)
    return conclude(task, basins, started=started, searched=time.perf_counter(), on_step=on_step)


def conclude(
    task: CalibrationTask, basins: SearchResult, *, started: float, searched: float, on_step: OnStep = ignore_progress
) -> CalibrationOutcome:
    """Calibrate from the coarse fits; `started` and `searched` are readings of `time.perf_counter`."""
    ranked = fit_hypotheses(task, basins.fits, on_step)
    task, ranked, known = _with_shown_angles(task, ranked, basins.report.seed, on_step)
    screened, metal = _without_metal(task, by_hypothesis(ranked), on_step)
    if screened is not task:
        task, ranked = screened, fit_hypotheses(screened, by_hypothesis(ranked), on_step)
    best = _best_fit(task, ranked, basins.report.seed, on_step)
    of_metal = () if metal is None else (metal.reason(ranked[0].hypothesis.handedness, best.fit.position_mm),)
    prepared, joint, statistics, source_distance = with_theta(
        task, replace(_without_faults(best, task), known=known), on_step
    )
    adjusted = (*task.screening.adjustments, *of_metal, *prepared.adjustments)
    task = replace(task, scanner=joint.seen_by(task.scanner))
    refined = time.perf_counter()
    fit = as_fit(joint, statistics.covariance, task.true_axis, task.scanner.source_to_cor_mm)
    frame = fit.frame
    radius_mm = task.radius_mm(ranked[0].hypothesis.handedness, fit.position_mm)
    analysis = analyse_residual(joint, statistics, task.scanner, radius_mm)
    theta, twin = choose_theta(task.scanner, frame, task.bounds)
    of_views = view_errors(joint, statistics)
    bars = error_bars(task.scanner, frame, theta, statistics, radius_mm, of_views, analysis.bound_times)
    alternatives = alternatives_of(ranked, task.sinogram.size / bars.statistics.inflation)
    alternatives = _told_apart(alternatives, task, ranked, joint, on_step)
    scale = scale_uncertainty(
        task.scanner, frame, task.phantom, bars.covariance.values, radius_mm, aspect_half=_aspect_half(task, joint)
    )
    in_bounds = task.bounds is None or task.bounds.contain(theta)
    evidence = Evidence(fit, source_distance, alternatives, scale, bars, analysis, in_bounds, task.saturated_share)
    ended = time.perf_counter()
    return CalibrationOutcome(
        task=task,
        hypothesis=ranked[0].hypothesis,
        theta=theta,
        theta_twin=twin,
        findings=evidence,
        residual=joint.model.residual,
        adjustments=(*adjusted, *analysis.adjustments),
        judgement=judge(evidence, JudgementLimits.of(task)),
        view_poses=None if joint.poses is None else joint.model.pose,
        beam=_beam(joint.model),
        search=basins.report,
        timing=StageSeconds(ended - started, searched - started, refined - searched, ended - refined),
    )


def _told_apart(
    alternatives: Alternatives, task: CalibrationTask, ranked: Sequence[RankedFit], joint: JointFit, on_step: OnStep
) -> Alternatives:
    """Fit the second hypothesis with all effects too where the plain fits do not decide, and drop it if refused."""
    first, *others = alternatives.hypotheses
    if not others or not alternatives.undecided(others[0].relative_residual):
        return alternatives
    second = next(one for one in ranked if one.hypothesis != ranked[0].hypothesis)
    try:
        _, other, *_ = with_theta(task, _without_faults(_plain(task, second, on_step), task), on_step)
    except CalibrationError:
        return replace(alternatives, hypotheses=(first, *others[1:]))
    ratio = float(np.linalg.norm(other.model.residual) / np.linalg.norm(joint.model.residual))
    both = replace(others[0], relative_residual=ratio * first.relative_residual)
    return replace(alternatives, hypotheses=(first, both, *others[1:]))


def _aspect_half(task: CalibrationTask, joint: JointFit) -> float:
    """Return half the difference between the phantom's directions, of which the right one is not known; 0 if known."""
    if task.true_axis is not None and not joint.motion_sets.may_be(DEFORMATION):
        return 0.0
    return 0.5 * abs(joint.aspect)


def _beam(model: ScanModel) -> BeamCorrection:
    """Fit hardening and scatter, if there is any, to all samples with equal weights at the known geometry and effects.

    The joint fit takes out what all views share, and with it much of a round phantom's hardening. The joint fit's
    scatter is a share of the beam that is left behind the object, which cannot be transferred from the phantom to a
    log: the fit here gives scatter as a share of what the object takes out of the beam.
    """
    around, wide = model.size(Term.SCATTER), model.size(Term.SCATTER_WIDE)
    hardens = model.size(Term.HARDENING) != 0.0 or model.size(Term.HARDENING_CUBIC) != 0.0
    if not (around or wide or hardens):
        return NOTHING_FOUND
    lengths, integrals, weights = model.lengths, model.sharp + model.residual, model.data.weights
    if around or wide:
        measured = integrals - np.log1p(np.maximum(around * model.halos[0] + wide * model.halos[1], -0.95))
        fitted = fit_scatter_and_hardening(lengths, measured, model.residual, weights)
        if fitted is not None:
            return fitted
    if not hardens:
        return NOTHING_FOUND
    if weights is not None:
        lengths, integrals = lengths[weights > 0.0], integrals[weights > 0.0]
    return BeamCorrection(fit_hardening(lengths, integrals, from_counts=model.from_counts))


def _without_metal(
    task: CalibrationTask, fits: Mapping[PoseHypothesis, Sequence[Fit]], on_step: OnStep
) -> tuple[CalibrationTask, PhantomMetal | None]:
    """Return the task with the samples that see metal, and the metal if there is any, from fits to some samples."""
    if Adjustment.METAL in task.without or not fits:
        return task, None
    hypothesis, (best, *_) = min(fits.items(), key=lambda item: item[1][0].relative_residual)
    of_all = task if task.screening.hidden is None else replace(task, metal=np.zeros(task.sinogram.shape, bool))
    metal = find_metal(task.phantoms[hypothesis.handedness], of_all.full_data(hypothesis.rotation), best, on_step)
    return (of_all, None) if metal is None else (replace(task, metal=metal.samples), metal)


def _with_shown_angles(
    task: CalibrationTask, ranked: list[RankedFit], seed: int, on_step: OnStep
) -> tuple[CalibrationTask, list[RankedFit], tuple[KnownEffect, ...]]:
    """Give each view the angle that it shows, where no fit explains the scan and those angles explain it far better."""
    if not ranked or task.of_passages or not {Adjustment.PACE, Adjustment.SLIP}.isdisjoint(task.without):
        return task, ranked, ()
    before = _plain(task, ranked[0], on_step).unexplained
    shown = None
    if before > WELL_EXPLAINED:
        shown = shown_angles(task, ranked[0], None if before < EXPLAINED else seed, on_step)
    if shown is None:
        return task, ranked, ()
    shown_task = replace(task, angles_rad=shown.angles_rad)
    left = _plain(shown_task, shown.ranked, on_step).unexplained
    if left > EXPLAINED or 2.0 * left > before:  # other angles than those given explain most of what these leave
        return task, ranked, ()
    return shown_task, fit_hypotheses(shown_task, search(shown_task, seed, None, on_step).fits, on_step), shown.effects


def _plain(task: CalibrationTask, ranked: RankedFit, on_step: OnStep) -> AdjustedFit:
    """Return a fit without adjustments."""
    (handedness, rotation), fit = ranked
    return AdjustedFit(task.phantoms[handedness], task.full_data(rotation), fit, task.from_counts, on_step=on_step)


def _best_fit(task: CalibrationTask, ranked: list[RankedFit], seed: int, on_step: OnStep) -> AdjustedFit:
    """Return the best fit without adjustments, or refuse the scan if this fit does not explain it as this phantom."""

    def likelier() -> str | None:
        return _likelier_drawing(task, seed, on_step)

    if not ranked:
        refuse_unfound(task.scanner, task.phantom, None, 1.0, likelier)
    best = _plain(task, ranked[0], on_step)
    refuse_unfound(task.scanner, task.phantom, best.fit, best.unexplained, likelier)
    return best


def _likelier_drawing(task: CalibrationTask, seed: int, on_step: OnStep) -> str | None:
    """Return the name of the first built-in drawing with which the search explains the scan; None without one."""
    others = (phantom for phantom in BUILT_IN.values() if phantom.shapes != task.phantom.shapes)
    return next(
        (
            phantom.name
            for phantom in others
            if search(replace(task, phantom=phantom), seed, None, on_step).report.converged
        ),
        None,
    )


def _without_faults(adjusted: AdjustedFit, task: CalibrationTask) -> AdjustedFit:
    """Adjust the plain fit to faults; outliers of passages are looked for when the views' poses are known."""
    for finding in BEFORE:
        if finding.adjustment not in task.without and not (finding is OUTLIERS and task.of_passages):
            adjusted = finding.adjust(adjusted)
    return replace(adjusted, of_passages=task.of_passages)
