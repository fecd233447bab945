"""The rule by which a drift check counts for its scanner's drift chart."""

from collections.abc import Sequence
from datetime import datetime
from typing import NamedTuple

from sawmill_vocabulary import Rotation

# The largest square of the correlation between u_c and tilt: nearer to 1, rounding decides what the inverse is.
MOST_CORRELATED = 1.0 - 1e-9


class DriftCheck(NamedTuple):
    """A drift check that succeeded, and the active calibration, whose phantom came at `phantom_came_at`.

    `covariance` belongs to (u_c, tilt, source to detector) in mm and radians. `is_counted` tells that a check of the
    same file by the same method is in the chart.
    """

    calibration_id: str
    active_id: str
    log_came_at: datetime
    phantom_came_at: datetime
    rotation: Rotation
    active_rotation: Rotation | None
    method: str | None
    covariance: Sequence[Sequence[float]]
    is_counted: bool


def counts_for_chart(check: DriftCheck) -> bool:
    """Return whether a drift check is a point of the chart since the active calibration.

    A check counts if it compared with the active calibration a log that was scanned after that calibration's phantom
    and turned in the same sense, if its covariance can be inverted, and if the same file is not in the chart.
    """
    return (
        check.calibration_id == check.active_id
        and check.log_came_at > check.phantom_came_at
        and check.rotation == check.active_rotation
        and _is_certain(check)
        and not check.is_counted
    )


def _is_certain(check: DriftCheck) -> bool:
    """Return whether the covariance of (u_c, tilt) can be inverted, also after a conversion to degrees and back."""
    (column, cross, _), (_, tilt, _), _ = check.covariance
    return check.method is not None and column > 0.0 and tilt > 0.0 and cross**2 < MOST_CORRELATED * column * tilt
