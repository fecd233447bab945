"""The rule by which a drift check counts for its scanner's drift chart."""

from datetime import datetime
from typing import NamedTuple

from sawmill_vocabulary import Rotation

Covariance = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

# The largest square of the correlation between u_c and tilt: nearer to 1, rounding decides what the inverse is.
MOST_CORRELATED = 1.0 - 1e-9


class ActiveCalibration(NamedTuple):
    """The calibration that a scanner uses; `phantom_came_at` is when the scan came that it was made of."""

    id: str
    phantom_came_at: datetime
    rotation: Rotation | None


class DriftCheck(NamedTuple):
    """A drift check that has succeeded.

    Attributes
    ----------
    calibration_id : str
        The calibration with which it compared the log.
    covariance : 3 x 3
        Covariance of (u_c, tilt, source to detector) in mm and radians.
    is_counted : bool
        Whether a check of the same file by the same method is in the chart already.
    """

    calibration_id: str
    log_came_at: datetime
    rotation: Rotation
    method: str | None
    covariance: Covariance
    is_counted: bool


def counts_for_chart(check: DriftCheck, active: ActiveCalibration) -> bool:
    """Return whether a drift check is a point of the chart since the active calibration.

    A check counts if it compared with the active calibration a log that was scanned after that calibration's phantom
    and turned in the same sense, if its covariance can be inverted, and if the same file is not in the chart.
    """
    return (
        check.calibration_id == active.id
        and check.log_came_at > active.phantom_came_at
        and check.rotation == active.rotation
        and check.method is not None
        and _is_certain(check.covariance)
        and not check.is_counted
    )


def _is_certain(covariance: Covariance) -> bool:
    """Return whether the covariance of (u_c, tilt) can be inverted, also after a conversion to degrees and back."""
    (column, cross, _), (_, tilt, _), _ = covariance
    return column > 0.0 and tilt > 0.0 and cross**2 < MOST_CORRELATED * column * tilt
