"""The facts about a scanner that decide its next step, and which calibrations activate and which drift checks count."""

from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import CalibrationResult, Comparison
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scanners import Tolerances
from sawmill_vocabulary import DetectorEstimate, Rotation, Verdict
from sawmill_vocabulary.movement_messages import LogMessage

# From this share on a scanner is watched, though it may move by more: the next check may find it out of tolerance.
NEARLY = 0.7


@dataclass(frozen=True)
class Moved:
    """The movement of a scanner's rays since a calibration, seen by a later calibration or by a log.

    `since_active` tells that this calibration is still in use; otherwise a newer one has taken the movement up.
    """

    ray_change_mm: float
    tolerance_mm: float
    within_tolerance: bool
    at: datetime
    since_active: bool

    @property
    def share(self) -> float:
        """Share of the tolerance."""
        return self.ray_change_mm / self.tolerance_mm

    @property
    def tone(self) -> str:
        """Colour of the bar: `idle` where a calibration has taken the movement up."""
        if not self.since_active:
            return "idle"
        return "bad" if not self.within_tolerance else "watch" if self.share >= NEARLY else "good"


class Calibrated(NamedTuple):
    """A calibration that succeeded."""

    id: str
    created_at: datetime
    result: CalibrationResult


class Checked(NamedTuple):
    """A drift check that ended; `within_tolerance` is None where it failed or could not tell."""

    created_at: datetime
    calibration_id: str | None
    within_tolerance: bool | None
    ray_change_mm: float = 0.0
    tolerance_mm: float = 0.0
    explanation: CodedReason | None = None


@dataclass(frozen=True)
class ScannerState:
    """The facts about one scanner that decide its next step (`next_step.py`).

    `newest` is the newest calibration that succeeded, `active_id` the one in use, `failure` why a newer one failed.
    `red` is the newest one that nobody has accepted, passed over or discarded and that shows the scanner red.
    `last_check` is the newest drift check that ended, `seen` the newest one that could tell whether the scanner has
    moved since the active calibration. `imported` tells of a geometry of another program. `alarms` are the open ones.
    """

    newest: Calibrated | None = None
    active_id: str | None = None
    tolerances: Tolerances | None = None
    failure: str | None = None
    last_check: Checked | None = None
    seen: Checked | None = None
    scanned: bool = True
    imported: bool = False
    alarms: tuple[AlarmKind, ...] = ()
    red: Calibrated | None = None

    @property
    def allowed_mm(self) -> float:
        """Tolerance of movement, mm."""
        return (self.tolerances or Tolerances()).ray_change_mm

    @property
    def newest_is_active(self) -> bool:
        """True if the scanner's reconstructions use the newest calibration."""
        return self.newest is not None and self.newest.id == self.active_id

    @property
    def drifted(self) -> Checked | None:
        """The newest check that could tell, if it is later than the newest calibration and out of tolerance."""
        check = self._since_newest(self.seen)
        return check if check is not None and check.within_tolerance is False else None

    def shows(self, message: LogMessage) -> Checked | None:
        """Return the newest check that could tell, if its reason contains this message."""
        check = self._since_newest(self.seen)
        reason = None if check is None or check.explanation is None else check.explanation.reason
        return check if reason is not None and message in reason.codes else None

    @property
    def unseen(self) -> bool:
        """True if the newest drift check failed or could not tell: what an earlier check saw is still valid."""
        check = self._since_newest(self.last_check)
        return check is not None and check.calibration_id == self.active_id and check.within_tolerance is None

    @property
    def moved(self) -> Moved | None:
        """The last known movement; None where nothing has compared."""
        check = self._since_newest(self.seen)
        if check is not None:
            within = check.within_tolerance is True
            return Moved(check.ray_change_mm, check.tolerance_mm, within, check.created_at, since_active=True)
        newest, since_active = self.newest, self.compared
        change = newest.result.comparison if newest is not None and self.newest_is_active else since_active
        if newest is None or change is None:
            return None
        return Moved(
            change.ray_change_mm,
            change.tolerance_mm or self.allowed_mm,
            change.within_tolerance,
            newest.created_at,
            since_active=since_active is not None,
        )

    @property
    def compared(self) -> Comparison | None:
        """The newest calibration against the one in use; None where it was compared with another one."""
        comparison = None if self.newest is None or self.newest_is_active else self.newest.result.comparison
        return comparison if comparison is not None and comparison.calibration_id == self.active_id else None

    @property
    def is_compared(self) -> bool:
        """True if a calibration or a log shows how far the scanner has moved since the calibration in use."""
        return self.compared is not None or self._since_newest(self.seen) is not None

    def _since_newest(self, check: Checked | None) -> Checked | None:
        """Return a drift check if the newest calibration is no later."""
        if check is None or (self.newest is not None and check.created_at < self.newest.created_at):
            return None
        return check


# The smallest relative determinant of a covariance: below this, rounding decides what the inverse is.
LEAST_DETERMINANT = 1e-9


class DriftCheck(NamedTuple):
    """A drift check that succeeded, and the active calibration, whose phantom came at `phantom_came_at`.

    `change` is counted from the calibration that the check compared with, and has the check's own errors. `is_counted`
    tells that a check of the same file by the same method is in the chart.
    """

    calibration_id: str | None
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


def activation_reason(*, wanted: bool, schedule_id: str | None, rays_verdict: Verdict, has_moved: bool) -> str | None:
    """Return why a finished calibration activates itself; None where it does not.

    Activation on pass has to be `wanted`. An uncertain scale makes an image larger or smaller and blurs nothing: the
    verdict on the rays decides. A schedule never takes over a scanner that has moved by more than its tolerance since
    the active calibration: a technician has to see and to accept that.
    """
    if not wanted or rays_verdict != "pass" or (schedule_id is not None and has_moved):
        return None
    asker = "the request" if schedule_id is None else f"schedule {schedule_id}"
    return f"the rays pass; {asker} asked for activation on pass"
