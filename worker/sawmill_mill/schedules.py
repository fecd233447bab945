"""The rules of schedules: which scan is taken at a due time, and which due times are announced as missed."""

from collections.abc import Iterable, Mapping
from datetime import datetime
from types import MappingProxyType
from typing import NamedTuple

from sawmill_contracts.choices import ScheduleOutcome
from sawmill_contracts.jobs import JobState
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_vocabulary import FEWEST_PAIRED_VIEWS

FEWEST_VIEWS = FEWEST_PAIRED_VIEWS
"""A log of fewer views has too few to be compared. The drift check itself finds what else a scan lacks."""

UNSEEN: tuple[JobState, ...] = (JobState.FAILED, JobState.CANCELLED)
"""States of a drift check's job in which the check has not seen its log."""

WHY_NOTHING_WAS_QUEUED: Mapping[ScheduleOutcome, str] = MappingProxyType(
    {
        "no-new-phantom-scan": "there was no new scan of a phantom",
        "no-new-log-scan": "there was no new scan of a log that a drift check could use",
        "no-active-calibration": "the scanner has no active calibration to compare a log with",
    }
)


class PhantomScan(NamedTuple):
    """A phantom scan of a scanner; `is_used` tells that a schedule has calibrated with it."""

    id: str
    state: ScanState
    phantom_state: PhantomState
    is_used: bool


class LogScan(NamedTuple):
    """A scan without a phantom; `is_checked` tells that there is a drift check of it, whatever its state."""

    id: str
    created_at: datetime
    state: ScanState
    views: int
    is_checked: bool


class Choice(NamedTuple):
    """The outcome of a due time, and the scan for which a job is queued."""

    outcome: ScheduleOutcome
    scan_id: str | None = None


class Missed(NamedTuple):
    """A due time that is announced as missed."""

    due_at: datetime
    reason: str


def choose_phantom_scan(newest_first: Iterable[PhantomScan]) -> Choice:
    """Choose the newest usable phantom scan, unless a schedule has used it: an older one shows the past."""
    usable = (scan for scan in newest_first if _is_usable(scan))
    newest = next(usable, None)
    return Choice("no-new-phantom-scan") if newest is None or newest.is_used else Choice("queued", newest.id)


def choose_log_scan(
    newest_first: Iterable[LogScan], last_checked_at: datetime | None, *, has_active_calibration: bool = True
) -> Choice:
    """Choose the newest log scan that is fit for a drift check.

    Parameters
    ----------
    last_checked_at : datetime or None
        When the newest stored log came that a drift check has seen: an older log shows the past.
    """
    if not has_active_calibration:
        return Choice("no-active-calibration")
    fit = (scan for scan in newest_first if _is_fit(scan, last_checked_at))
    newest = next(fit, None)
    return Choice("no-new-log-scan") if newest is None else Choice("queued", newest.id)


def missed_due_time(
    first_due_at: datetime, due_at: datetime, outcome: ScheduleOutcome, *, missed_before: bool
) -> Missed | None:
    """Return the due time that is announced as missed; a schedule that keeps missing is announced when that begins.

    Parameters
    ----------
    first_due_at, due_at : datetime
        The first due time that has not run, and the latest one, which runs now.
    missed_before : bool
        Whether the schedule was missed at its last due time as well.
    """
    why_nothing = WHY_NOTHING_WAS_QUEUED.get(outcome)
    if first_due_at < due_at:
        later = "" if why_nothing is None else f"; later {why_nothing}"
        return Missed(first_due_at, f"nothing ran schedules then{later}")
    return None if why_nothing is None or missed_before else Missed(due_at, why_nothing)


def _is_usable(scan: PhantomScan) -> bool:
    return scan.state is ScanState.READY and scan.phantom_state is PhantomState.READY


def _is_fit(scan: LogScan, last_checked_at: datetime | None) -> bool:
    is_new = not scan.is_checked and (last_checked_at is None or scan.created_at > last_checked_at)
    return is_new and scan.state is ScanState.READY and scan.views >= FEWEST_VIEWS
