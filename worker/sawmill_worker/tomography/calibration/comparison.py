"""A new calibration against the active one: how far the rays moved, and the likely cause."""

import math
from dataclasses import dataclass

from sawmill_worker.tomography.calibration.calibration import CalibratedGeometry
from sawmill_worker.tomography.calibration.movement import likely_cause
from sawmill_worker.tomography.geometry import FloatArray, GeometryError, Scanner, angle_difference
from sawmill_worker.tomography.ray_error import ray_error


@dataclass(frozen=True)
class ChangeLimits:
    """What may change between two calibrations; None: the first angle may be any."""

    ray_change_mm: float
    angle_change_deg: float | None
    log_radius_mm: float


@dataclass(frozen=True)
class GeometryChange:
    """Differences new - active, whether they are within the limits, and one sentence."""

    ray_change_mm: float
    angle_change_deg: float
    cor_column_change_mm: float
    source_distance_change_mm: float
    tilt_change_deg: float
    within_tolerance: bool
    reason: str


def compare(
    scanner: Scanner, active: CalibratedGeometry, new: CalibratedGeometry, limits: ChangeLimits
) -> GeometryChange:
    """Differences new - active, and whether they are within the limits."""
    moved_mm = _moved_mm(scanner, active, new, limits.log_radius_mm)
    angle_deg = math.degrees(angle_difference(new.frame.psi_rad, active.frame.psi_rad))
    turned = limits.angle_change_deg is not None and abs(angle_deg) > limits.angle_change_deg
    reversed_ = new.rotation is not active.rotation
    if reversed_:
        reason = "the log turns the other way than at the active calibration: check the drive's direction"
    elif moved_mm > limits.ray_change_mm:
        cause = likely_cause(
            scanner,
            active.frame,
            new.frame,
            _covariance(active, new),
            allowed_mm=limits.ray_change_mm,
            radius_mm=limits.log_radius_mm,
        )
        reason = f"the rays moved {moved_mm:.2f} mm RMS where {limits.ray_change_mm:.2f} mm is allowed: {cause}"
    elif turned:
        reason = (
            f"the first angle changed by {angle_deg:+.3f} degrees and the rays did not move: the phantom was mounted "
            "turned, or the encoder's zero moved"
        )
    else:
        reason = f"the rays moved {moved_mm:.3f} mm RMS, within the {limits.ray_change_mm:.2f} mm allowed"
    return GeometryChange(
        ray_change_mm=moved_mm,
        angle_change_deg=angle_deg,
        cor_column_change_mm=new.frame.cor_column_mm - active.frame.cor_column_mm,
        source_distance_change_mm=new.frame.source_distance_mm - active.frame.source_distance_mm,
        tilt_change_deg=math.degrees(new.frame.tilt_rad - active.frame.tilt_rad),
        within_tolerance=not (reversed_ or turned or moved_mm > limits.ray_change_mm),
        reason=reason,
    )


def _moved_mm(scanner: Scanner, active: CalibratedGeometry, new: CalibratedGeometry, radius_mm: float) -> float:
    try:
        return ray_error(scanner, active.frame, new.frame, radius_mm=radius_mm).rms_mm
    except GeometryError:  # the active rays no longer meet the log: they moved by more than its radius
        return radius_mm


def _covariance(active: CalibratedGeometry, new: CalibratedGeometry) -> FloatArray | None:
    """Of the change; None where neither calibration has error bars."""
    known = [one.covariance for one in (active, new) if one.covariance is not None]
    return sum(known[1:], known[0]) if known else None
