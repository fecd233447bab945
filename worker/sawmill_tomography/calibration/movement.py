"""The simplest cause that explains the change of a scanner's geometry between two calibrations."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.calibration.scale import size_by_distance
from sawmill_tomography.geometry.fit_parameters import RAYS, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import ray_error, scale_ray_error
from sawmill_vocabulary import ObjectTurns
from sawmill_vocabulary.messages import Reason, Value
from sawmill_vocabulary.movement_messages import MovementMessage

# A cause explains a change when the rest is within this number of standard deviations (Mahalanobis).
SIGNIFICANT = 3.5
# A change that moves the rays by less than this share of the tolerance is no movement, however precisely known.
NEGLIGIBLE = 0.15


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
