"""A new calibration against the active one: movement of the rays, change of scale, and the likely cause."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.calibration.calibration import CalibratedGeometry
from sawmill_tomography.calibration.scale import size_by_distance
from sawmill_tomography.drift.change import SIGNIFICANT
from sawmill_tomography.geometry.fit_parameters import RAYS, FitParameter
from sawmill_tomography.geometry.geometry import (
    FloatArray,
    GeometryError,
    Scanner,
    SourceFrame,
    angle_difference,
    to_vector,
)
from sawmill_tomography.geometry.ray_error import RayError, ray_error, scale_deviation, scale_ray_error
from sawmill_tomography.statistics import TWO_SIDED_95
from sawmill_vocabulary import ObjectTurns
from sawmill_vocabulary.messages import Reason, Value
from sawmill_vocabulary.movement_messages import MovementMessage

# A change that moves the rays by less than this share of the tolerance is no movement, however precisely known.
NEGLIGIBLE = 0.15


@dataclass(frozen=True)
class ChangeLimits:
    """Largest allowed changes between two calibrations; a `psi_change_rad` of None allows any first angle."""

    ray_change_mm: float
    psi_change_rad: float | None
    log_radius_mm: float
    scale_change_percent: float


@dataclass(frozen=True)
class _Change:
    """Differences new - active."""

    ray_change_mm: float  # RMS distance of the rays, one common rotation and one common scale taken out
    scale_change_percent: float  # change of the common scale
    scale_change_uncertainty_percent: float | None  # uncertainty with 95 %, from both covariances
    psi_change_rad: float
    cor_column_change_mm: float
    source_distance_change_mm: float
    tilt_change_rad: float


@dataclass(frozen=True)
class GeometryChange(_Change):
    """Differences new - active, whether the limits are held, and the reason."""

    within_tolerance: bool
    reason: Reason


def compare(
    scanner: Scanner, active: CalibratedGeometry, new: CalibratedGeometry, limits: ChangeLimits
) -> GeometryChange:
    """Compute the differences new - active, and whether they are within the limits."""
    moved = _moved(scanner, active, new, limits.log_radius_mm)
    covariance = _covariance(active, new)
    spread = None if covariance is None else _scale_spread_percent(scanner, new.frame, covariance, limits.log_radius_mm)
    change = _Change(
        ray_change_mm=moved.rms_mm,
        scale_change_percent=100.0 * moved.scale_change,
        scale_change_uncertainty_percent=spread,
        psi_change_rad=angle_difference(new.frame.psi_rad, active.frame.psi_rad),
        cor_column_change_mm=new.frame.cor_column_mm - active.frame.cor_column_mm,
        source_distance_change_mm=new.frame.source_distance_mm - active.frame.source_distance_mm,
        tilt_change_rad=new.frame.tilt_rad - active.frame.tilt_rad,
    )
    complaint = next(_complaints(scanner, active, new, change, limits), None)
    reason = _within(change, limits) if complaint is None else complaint
    return GeometryChange(**vars(change), within_tolerance=complaint is None, reason=reason)


def _complaints(
    scanner: Scanner, active: CalibratedGeometry, new: CalibratedGeometry, change: _Change, limits: ChangeLimits
) -> Iterator[Reason]:
    """Yield a reason for each limit that the change exceeds, the gravest first."""
    if new.rotation is not active.rotation:
        yield MovementMessage.TURNED_OVER()
    moved_mm, resized = change.ray_change_mm, abs(change.scale_change_percent) > limits.scale_change_percent
    if moved_mm > limits.ray_change_mm or resized:
        cause = likely_cause(
            scanner,
            active.frame,
            new.frame,
            _covariance(active, new),
            allowed_mm=limits.ray_change_mm,
            radius_mm=limits.log_radius_mm,
        )
        if moved_mm > limits.ray_change_mm:
            yield MovementMessage.MOVED(cause, moved_mm=moved_mm, allowed_mm=limits.ray_change_mm)
        if resized:
            without_bars = change.scale_change_uncertainty_percent is None
            message = MovementMessage.RESCALED_WITHOUT_BARS if without_bars else MovementMessage.RESCALED
            yield message(cause, allowed_percent=limits.scale_change_percent, **_scale_values(change))
    if limits.psi_change_rad is not None and abs(change.psi_change_rad) > limits.psi_change_rad:
        yield MovementMessage.FIRST_ANGLE(angle_deg=math.degrees(change.psi_change_rad))


def _within(change: _Change, limits: ChangeLimits) -> Reason:
    """Return the reason where every limit is held; a change of scale beyond its uncertainty is reported too."""
    values: dict[str, Value] = {"moved_mm": change.ray_change_mm, "allowed_mm": limits.ray_change_mm}
    spread = change.scale_change_uncertainty_percent
    if spread is None or abs(change.scale_change_percent) <= spread:
        return MovementMessage.WITHIN(**values)
    return MovementMessage.WITHIN_RESCALED(**values, **_scale_values(change))


def _scale_values(change: _Change) -> dict[str, Value]:
    spread = change.scale_change_uncertainty_percent
    of_spread: dict[str, Value] = {} if spread is None else {"spread_percent": spread}
    return {"scale_percent": change.scale_change_percent, **of_spread}


def _moved(scanner: Scanner, active: CalibratedGeometry, new: CalibratedGeometry, radius_mm: float) -> RayError:
    try:
        before, after = (scanner.with_cells_of(each.scanner) for each in (active, new))
        frame = new.frame
        if scanner.object_turns is ObjectTurns.BETWEEN_PASSAGES:
            # A common shift of the views looks like another u_c.
            frame = replace(frame, cor_column_mm=active.frame.cor_column_mm)
        return ray_error(before, active.frame, frame, radius_mm=radius_mm, other_scanner=after)
    except GeometryError:  # the active rays no longer meet the log: they moved by more than its radius
        return RayError(radius_mm, radius_mm, new.frame.source_distance_mm / active.frame.source_distance_mm - 1.0)


def _scale_spread_percent(
    scanner: Scanner, frame: SourceFrame, covariance: FloatArray, radius_mm: float
) -> float | None:
    try:
        return 100.0 * TWO_SIDED_95 * scale_deviation(scanner, frame, covariance, radius_mm=radius_mm)
    except GeometryError:  # the new rays do not meet the log
        return None


def _covariance(active: CalibratedGeometry, new: CalibratedGeometry) -> FloatArray | None:
    """Return the covariance of the change; None where neither calibration has error bars."""
    covariances = [one.covariance for one in (active, new) if one.covariance is not None]
    return sum(covariances[1:], covariances[0]) if covariances else None


@dataclass(frozen=True)
class _Cause:
    """A cause: directions of (R, SDD, u_c, tau) in which a scanner moves, and its message."""

    directions: tuple[tuple[float, float, float, float], ...]
    message: MovementMessage


_SIZE = _Cause(((1.0, 0.0, 0.0, 0.0),), MovementMessage.SIZE)
# The simplest causes come first: one thing that moved before two.
_CAUSES = (
    (
        _Cause(((0.0, 0.0, 1.0, 0.0),), MovementMessage.TURNTABLE),
        _Cause(((0.0, 0.0, 0.0, 1.0),), MovementMessage.TILT),
        _Cause(((0.0, 1.0, 0.0, 0.0),), MovementMessage.STAND),
        _SIZE,
        _Cause(((1.0, 1.0, 0.0, 0.0),), MovementMessage.SOURCE),
    ),
    (_Cause(((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)), MovementMessage.KNOCKED),),
)


def likely_cause(
    scanner: Scanner,
    before: SourceFrame,
    after: SourceFrame,
    covariance: FloatArray | None,
    *,
    allowed_mm: float,
    radius_mm: float,
) -> Reason:
    """Return what moved, and what to check.

    `covariance` (5, 5) or None: covariance of the change of (psi, R, SDD, u_c, tau): the sum of both calibrations'
    covariances; None where neither calibration has one.
    """
    change = to_vector(after) - to_vector(before)
    values: dict[str, Value] = {
        "source_mm": float(change[FitParameter.R]),
        "distance_mm": float(change[FitParameter.SDD]),
        "column_mm": float(change[FitParameter.U_C]),
        "tilt_deg": math.degrees(change[FitParameter.TILT]),
    }
    of_passages = scanner.object_turns is ObjectTurns.BETWEEN_PASSAGES
    spread = np.diag(_negligible(scanner, before, allowed_mm, radius_mm) ** 2)
    if covariance is not None:
        spread += covariance[RAYS, RAYS]
    for every in _CAUSES:
        causes = [cause for cause in every if not (of_passages and cause.message is MovementMessage.TURNTABLE)]
        remaining = [_remaining(change[RAYS], spread, np.array(cause.directions).T) for cause in causes]
        best = int(np.argmin(remaining))
        if remaining[best] < SIGNIFICANT:
            values |= _of_size(scanner, before, after) if causes[best] is _SIZE else {}
            return causes[best].message(**values)
    return MovementMessage.SEVERAL(**values)


def _of_size(scanner: Scanner, before: SourceFrame, after: SourceFrame) -> dict[str, Value]:
    """Return which size of the phantom explains a change of R alone, and the source shifts, as values of a message."""
    r_s = scanner.source_to_cor_mm
    shifts = [math.sqrt(max(frame.source_distance_mm**2 - r_s**2, 0.0)) for frame in (after, before)]
    size = size_by_distance(after.source_distance_mm, before.source_distance_mm)
    return {"shift_mm": shifts[0], "shift_before_mm": shifts[1], **size}


def _negligible(scanner: Scanner, frame: SourceFrame, allowed_mm: float, radius_mm: float) -> FloatArray:
    """Compute changes of (R, SDD, u_c, tau) that, each alone, move the rays by a negligible share, shape and scale."""
    steps = {"source_distance_mm": 1.0, "source_to_detector_mm": 1.0, "cor_column_mm": 0.1, "tilt_rad": 1e-3}
    sizes = []
    for name, step in steps.items():
        moved = replace(frame, **{name: getattr(frame, name) + step})
        try:
            shape = ray_error(scanner, frame, moved, radius_mm=radius_mm)
            scale_mm = scale_ray_error(scanner, frame, shape.scale_change, radius_mm=radius_mm)
            sizes.append(NEGLIGIBLE * allowed_mm * step / math.hypot(shape.rms_mm, scale_mm))
        except GeometryError:  # these rays do not meet the log: no change has a known size
            sizes.append(step)
    return np.array(sizes)


def _remaining(change: FloatArray, spread: FloatArray, directions: FloatArray) -> float:
    """Compute how many standard deviations of a change remain after the best movement in these directions (4, k)."""
    weight = np.linalg.inv(spread)
    rest = change - directions @ np.linalg.solve(directions.T @ weight @ directions, directions.T @ weight @ change)
    return math.sqrt(max(float(rest @ weight @ rest), 0.0))
