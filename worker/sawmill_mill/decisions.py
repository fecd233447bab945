"""The results that a person's decisions leave open: what was discarded, or ended before the last decision, is past."""

from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True)
class Decisions:
    """Times of the last decisions about a scanner's calibrations; None where there was no such decision.

    `activated_at` is when a calibration was accepted or rolled back to, `discarded_at` when one was discarded,
    `result_discarded_at` when one with a result was discarded: a failed attempt that is discarded says nothing about
    an earlier result, which may show that the scanner has moved.
    """

    activated_at: datetime | None = None
    discarded_at: datetime | None = None
    result_discarded_at: datetime | None = None

    def leave_failure_open(self, ended_at: datetime | None) -> bool:
        """Return whether nobody has decided anything since a calibration failed."""
        return _is_open(ended_at, self.activated_at, self.discarded_at)

    def leave_result_open(self, ended_at: datetime | None) -> bool:
        """Return whether a calibration with a result has still to be accepted or discarded."""
        return _is_open(ended_at, self.activated_at, self.result_discarded_at)


def _is_open(ended_at: datetime | None, *decided: datetime | None) -> bool:
    return ended_at is None or all(each is None or ended_at >= each for each in decided)
