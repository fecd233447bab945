"""Comparison of a new calibration with the active calibration, as a contract."""

import math

import numpy as np

from sawmill_contracts.calibrations import CalibrationResult, CalibrationSucceeded, Comparison
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scanners import StoredScanner
from sawmill_tomography.calibration.calibration import CalibratedGeometry
from sawmill_tomography.calibration.comparison import ChangeLimits, compare


def geometry_of(result: CalibrationResult) -> CalibratedGeometry:
    """Return the geometry of a stored calibration."""
    return CalibratedGeometry(
        scanner=result.scanner,
        theta=result.theta,
        frame=result.source_frame,
        rotation=result.rotation,
        covariance=None if result.covariance is None else np.array(result.covariance),
    )


def compared(active: CalibrationSucceeded, new: CalibratedGeometry, scanner: StoredScanner) -> Comparison:
    """Compute what changed since the active calibration, by the scanner's constants and tolerances."""
    tolerances = scanner.tolerances
    radius_mm = scanner.log_radius_mm or active.radius_mm
    psi_rad = None if tolerances.angle_change_deg is None else math.radians(tolerances.angle_change_deg)
    limits = ChangeLimits(tolerances.ray_change_mm, psi_rad, radius_mm, tolerances.scale_percent)
    change = compare(scanner.constants, geometry_of(active), new, limits)
    return Comparison(
        coded_reason=CodedReason.of(change.reason),
        calibration_id=active.id,
        tolerance_mm=limits.ray_change_mm,
        angle_change_deg=math.degrees(change.psi_change_rad),
        tilt_change_deg=math.degrees(change.tilt_change_rad),
        **{name: value for name, value in vars(change).items() if name in Comparison.model_fields},
    )
