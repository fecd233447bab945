"""What moved since the active calibration."""

import math

import numpy as np

from sawmill_worker.contracts.calibrations import CalibrationResult, CalibrationSucceeded, Comparison
from sawmill_worker.contracts.scanners import Scanner
from sawmill_worker.tomography.calibration.movement import likely_cause
from sawmill_worker.tomography.geometry import FloatArray, GeometryError, angle_difference
from sawmill_worker.tomography.ray_error import ray_error
from sawmill_worker.use_cases.conversion import to_frame, to_scanner


def compared(active: CalibrationSucceeded, new: CalibrationResult, scanner: Scanner) -> CalibrationResult:
    """The answer with its comparison; a scanner that moved is one of the reasons."""
    comparison = compare(active, new, scanner)
    reasons = new.reasons if comparison.within_tolerance else [comparison.reason, *new.reasons]
    return new.model_copy(update={"comparison": comparison, "reasons": reasons})


def compare(active: CalibrationSucceeded, new: CalibrationResult, scanner: Scanner) -> Comparison:
    """Differences new - active, and whether they are within the scanner's tolerances."""
    constants, tolerances = to_scanner(scanner.constants), scanner.tolerances
    old_frame, new_frame = to_frame(active.source_frame), to_frame(new.source_frame)
    try:
        moved = ray_error(constants, old_frame, new_frame, radius_mm=scanner.log_radius_mm).rms_mm
    except GeometryError:  # the old rays no longer meet the log: they moved by more than its radius
        moved = scanner.log_radius_mm
    angle = math.degrees(angle_difference(new_frame.psi_rad, old_frame.psi_rad))
    turned = tolerances.angle_change_deg is not None and abs(angle) > tolerances.angle_change_deg
    reversed_ = new.rotation is not active.rotation
    if reversed_:
        reason = "the log turns the other way than at the active calibration: check the drive's direction"
    elif moved > tolerances.ray_change_mm:
        cause = likely_cause(
            constants,
            old_frame,
            new_frame,
            _covariance(active, new),
            allowed_mm=tolerances.ray_change_mm,
            radius_mm=scanner.log_radius_mm,
        )
        reason = f"the rays moved {moved:.2f} mm RMS where {tolerances.ray_change_mm:.2f} mm is allowed: {cause}"
    elif turned:
        reason = (
            f"the first angle changed by {angle:+.3f} degrees and the rays did not move: the phantom was mounted "
            "turned, or the encoder's zero moved"
        )
    else:
        reason = f"the rays moved {moved:.3f} mm RMS, within the {tolerances.ray_change_mm:.2f} mm allowed"
    return Comparison(
        calibration_id=active.id,
        ray_change_mm=moved,
        angle_change_deg=angle,
        cor_column_change_mm=new_frame.cor_column_mm - old_frame.cor_column_mm,
        source_distance_change_mm=new_frame.source_distance_mm - old_frame.source_distance_mm,
        tilt_change_deg=math.degrees(new_frame.tilt_rad - old_frame.tilt_rad),
        within_tolerance=not (reversed_ or turned or moved > tolerances.ray_change_mm),
        reason=reason,
    )


def _covariance(active: CalibrationResult, new: CalibrationResult) -> FloatArray | None:
    """Of the change; None where neither calibration has error bars."""
    known = [np.array(one.covariance) for one in (active, new) if one.covariance is not None]
    return np.sum(known, axis=0) if known else None
