"""A calibration with the log next to the phantom: geometry, error bars and judgement follow from both bodies."""

from dataclasses import replace

import numpy as np

from sawmill_tomography.calibration.calibration import CalibrationOutcome, choose_theta
from sawmill_tomography.calibration.covariance import scaled_inverse, theta_covariance
from sawmill_tomography.calibration.fit import Fit
from sawmill_tomography.calibration.joint_fit.residual_statistics import ErrorBars
from sawmill_tomography.calibration.judgement import Evidence, JudgementLimits, judge
from sawmill_tomography.calibration.scale import scale_uncertainty
from sawmill_tomography.calibration.second_witness import BOTH, LogAnswer, LogWitness, compare_witnesses
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta
from sawmill_tomography.geometry.ray_error import predicted_ray_error
from sawmill_vocabulary import Rotation
from sawmill_vocabulary.uncertainty import UncertaintySource

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
    bars = _error_bars(calibration, evidence.error_bars, fit.frame, theta, witness)
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
    calibration: CalibrationOutcome, alone: ErrorBars, frame: SourceFrame, theta: Theta, witness: LogWitness
) -> ErrorBars:
    scanner, values = calibration.scanner, witness.covariance
    of_theta = theta_covariance(scanner, frame, theta, values)
    kept, by_log, by_holding = np.eye(len(alone.ray_covariance)), *np.zeros((2, *alone.ray_covariance.shape))
    kept[FRAME, FRAME], by_log[FRAME, FRAME] = witness.kept, witness.by_log
    by_holding[FRAME, FRAME] = np.outer(witness.step, witness.step)
    parts = {source: kept @ part @ kept.T for source, part in alone.parts.items()} | {UncertaintySource.LOG: by_log}
    parts[UncertaintySource.HELD_DISTANCE] = parts.get(UncertaintySource.HELD_DISTANCE, 0.0) + by_holding
    of_rays = kept @ alone.ray_covariance @ kept.T + by_log + by_holding
    motions = alone.mixture
    if motions is not None and not np.array_equal(values, alone.covariance.values):
        # The log takes as much off the error by what else may be real as off the phantom's other errors.
        errors = motions.errors.copy()
        errors[:, FRAME] = errors[:, FRAME] @ (values @ scaled_inverse(alone.covariance.values)).T
        motions = replace(motions, errors=errors)
    return replace(
        alone,
        covariance=replace(alone.covariance, values=values),
        ray_covariance=of_rays,
        theta_covariance=of_theta,
        predicted_ray_error=predicted_ray_error(
            scanner,
            frame,
            of_rays,
            alone.hidden_modules,
            motions,
            radius_mm=calibration.radius_mm,
            further_mm=alone.further_mm,
        ),
        source_shift_resolved=of_theta is not None,
        parts=parts,
    )
