"""A calibration with the log next to the phantom: geometry, error bars and judgement follow from both bodies."""

from dataclasses import replace

import numpy as np

from sawmill_tomography.calibration.calibration import CalibrationOutcome, choose_theta
from sawmill_tomography.calibration.covariance import scaled_inverse
from sawmill_tomography.calibration.fit import Fit
from sawmill_tomography.calibration.joint_fit.residual_statistics import ErrorBars, error_bars
from sawmill_tomography.calibration.judgement import Evidence, JudgementLimits, judge
from sawmill_tomography.calibration.scale import scale_uncertainty
from sawmill_tomography.calibration.second_witness import BOTH, LogAnswer, LogWitness, compare_witnesses
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta
from sawmill_vocabulary import Rotation

POSITION = [FitParameter.T_X, FitParameter.T_Y]


def with_log(calibration: CalibrationOutcome, log_sinogram: FloatArray) -> CalibrationOutcome:
    """Add the log as a second witness to a calibration; without error bars the calibration is returned unchanged.

    Parameters
    ----------
    log_sinogram : (views, detector) float
        Line integrals of the log at the views of the phantom's sinogram.

    Raises
    ------
    DriftError
        If the log shows nothing: too few views, a log too round, or a log that reaches an end of the detector.
    """
    evidence, task = calibration.findings, calibration.task
    if not isinstance(evidence, Evidence):
        return calibration
    covariance = evidence.error_bars.covariance.values
    witness = compare_witnesses(
        task.scanner,
        calibration.frame,
        covariance,
        _ask_log(task.scanner, log_sinogram, task.angles_rad, calibration.frame, calibration.rotation),
        calibration.rotation,
        phantom_moved=evidence.residual.phantom_moved,
        radius_mm=calibration.radius_mm,
    )
    return _following(calibration, evidence, witness)


def _ask_log(
    scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray, frame: SourceFrame, rotation: Rotation
) -> LogAnswer:
    """Fit u_c and tau to a log's sinogram (views, detector) near the phantom's answer by opposite rays or pairs."""
    fit = detector_fit(scanner, sinogram, angles_rad, frame, rotation)
    turned = fit.rotation if fit.rotation_decided else rotation
    # Pairs of views refuse a log that moves far, and do not show where a log jumped a little.
    return LogAnswer(fit.at_distance(frame.source_to_detector_mm), fit.sdd_sensitivity, turned, fit.movement)


def _following(calibration: CalibrationOutcome, evidence: Evidence, witness: LogWitness) -> CalibrationOutcome:
    task, fit = calibration.task, _moved(evidence.fit, witness)
    theta, twin = choose_theta(task.scanner, fit.frame, task.bounds)
    bars = _error_bars(calibration, evidence, fit.frame, theta, witness)
    in_bounds = task.bounds is None or task.bounds.contain(theta)
    scale = scale_uncertainty(
        task.scanner,
        fit.frame,
        task.phantom,
        witness.covariance,
        calibration.radius_mm,
        aspect_half=evidence.scale.aspect_half,
    )
    with_witness = replace(evidence, fit=fit, error_bars=bars, scale=scale, theta_in_bounds=in_bounds, witness=witness)
    judgement = judge(with_witness, JudgementLimits.of(task))
    return replace(calibration, theta=theta, theta_twin=twin, findings=with_witness, judgement=judgement)


def _moved(fit: Fit, witness: LogWitness) -> Fit:
    """Return the fit with the geometry of both bodies, and the phantom's position that fits this u_c and tau."""
    frame = SourceFrame.from_vector(witness.vector)
    values = fit.covariance.values
    own = values[np.ix_(BOTH, BOTH)]
    step = values[np.ix_(POSITION, BOTH)] @ np.linalg.solve(own, witness.vector[BOTH] - witness.phantom.values)
    x, y = fit.position_mm
    return replace(fit, frame=frame, position_mm=(x + float(step[0]), y + float(step[1])))


def _error_bars(
    calibration: CalibrationOutcome, evidence: Evidence, frame: SourceFrame, theta: Theta, witness: LogWitness
) -> ErrorBars:
    alone = evidence.error_bars
    statistics, before, values = alone.statistics, alone.covariance.values, witness.covariance
    kept, by_log = np.eye(len(statistics.ray_covariance)), np.zeros_like(statistics.ray_covariance)
    kept[FRAME, FRAME] = witness.kept
    by_log[FRAME, FRAME] = values - witness.kept @ before @ witness.kept.T
    motions = statistics.mixture
    if motions is not None and not np.array_equal(values, before):
        # The log takes as much off the error by what else may be real as off the phantom's other errors.
        errors = motions.errors.copy()
        errors[:, FRAME] = errors[:, FRAME] @ (values @ scaled_inverse(before)).T
        motions = replace(motions, errors=errors)
    with_log = replace(
        statistics,
        covariance=replace(statistics.covariance, values=values),
        ray_covariance=kept @ statistics.ray_covariance @ kept.T + by_log,
        parts={source: kept @ part @ kept.T for source, part in statistics.parts.items()} | {"log": by_log},
        mixture=motions,
    )
    times, radius_mm = evidence.residual.bound_times, calibration.radius_mm
    return error_bars(calibration.scanner, frame, theta, with_log, radius_mm, bound_times=times)
