"""What moved since the active calibration."""

import math

from worker.contracts.calibrations import CalibrationResult, CalibrationSucceeded, Comparison
from worker.contracts.scanners import Scanner
from worker.tasks.conversion import to_frame, to_scanner
from worker.tomography.geometry import GeometryError, angle_difference
from worker.tomography.ray_error import ray_error


def compare(active: CalibrationSucceeded, new: CalibrationResult, scanner: Scanner) -> Comparison:
    """Differences new - active, and whether they are within the scanner's tolerances."""
    old_frame, new_frame = to_frame(active.source_frame), to_frame(new.source_frame)
    try:
        moved = ray_error(to_scanner(scanner.constants), old_frame, new_frame, radius_mm=scanner.log_radius_mm).rms_mm
    except GeometryError:  # the old rays no longer meet the log: they moved by more than its radius
        moved = scanner.log_radius_mm
    angle = math.degrees(angle_difference(new_frame.psi_rad, old_frame.psi_rad))
    column = new_frame.cor_column_mm - old_frame.cor_column_mm
    tilt = math.degrees(new_frame.tilt_rad - old_frame.tilt_rad)
    tolerances = scanner.tolerances
    turned = tolerances.angle_change_deg is not None and abs(angle) > tolerances.angle_change_deg
    reversed_ = new.rotation is not active.rotation
    reason = _reason(
        moved=moved,
        allowed=tolerances.ray_change_mm,
        column=column,
        tilt=tilt,
        angle=angle if turned else None,
        reversed_rotation=reversed_,
    )
    return Comparison(
        calibration_id=active.id,
        ray_change_mm=moved,
        angle_change_deg=angle,
        cor_column_change_mm=column,
        source_distance_change_mm=new_frame.source_distance_mm - old_frame.source_distance_mm,
        tilt_change_deg=tilt,
        within_tolerance=not (reversed_ or turned or moved > tolerances.ray_change_mm),
        reason=reason,
    )


def _reason(
    *, moved: float, allowed: float, column: float, tilt: float, angle: float | None, reversed_rotation: bool
) -> str:
    if reversed_rotation:
        return "the log turns the other way than at the active calibration: check the drive's direction"
    if moved > allowed:
        return (
            f"the rays moved {moved:.2f} mm RMS where {allowed:.2f} mm is allowed: the centre of rotation moved "
            f"{column:+.2f} mm on the detector and the tilt changed by {tilt:+.3f} degrees"
        )
    if angle is not None:
        return f"the first angle changed by {angle:+.3f} degrees: check the encoder's zero and the phantom's mounting"
    return f"the rays moved {moved:.3f} mm RMS, within the {allowed:.2f} mm allowed"
