"""The rule by which a drift check counts for its scanner's drift chart."""

from datetime import datetime
from typing import NamedTuple

from sawmill_vocabulary import DetectorEstimate, Rotation

# The smallest relative determinant of a covariance: below this, rounding decides what the inverse is.
LEAST_DETERMINANT = 1e-9


class DriftCheck(NamedTuple):
    """A drift check that succeeded, and the active calibration, whose phantom came at `phantom_came_at`.

    `change` is counted from the calibration that the check compared with, and has the check's own errors. `is_counted`
    tells that a check of the same file by the same method is in the chart.
    """

    calibration_id: str
    active_id: str
    log_came_at: datetime
    phantom_came_at: datetime
    rotation: Rotation
    active_rotation: Rotation | None
    method: str | None
    change: DetectorEstimate
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
        and check.method is not None
        and check.change.relative_determinant > LEAST_DETERMINANT
        and not check.is_counted
    )
