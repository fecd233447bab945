"""The rules of schedules: which scan is taken at a due time, and which due times are announced as missed."""

from collections.abc import Iterable, Mapping
from datetime import datetime
from types import MappingProxyType
from typing import NamedTuple

from sawmill_contracts.choices import ScheduleOutcome
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import JobState
from sawmill_vocabulary import FEWEST_PAIRED_VIEWS

# A log of fewer views has too few to be compared. The drift check itself finds what else a scan lacks.
FEWEST_VIEWS = FEWEST_PAIRED_VIEWS
# A drift check whose job ended so has not seen its log.
UNSEEN = (JobState.FAILED, JobState.CANCELLED)
WHY_NOTHING_WAS_QUEUED: Mapping[ScheduleOutcome, str] = MappingProxyType(
    {
        "no-new-phantom-scan": "there was no new scan of a phantom",
        "no-new-log-scan": "there was no new scan of a log that a drift check could use",
        "no-active-calibration": "the scanner has no active calibration to compare a log with",
    }
)


class PhantomScan(NamedTuple):
    """A phantom scan; `is_used` tells that a schedule has calibrated with it."""

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


def phantom_scan_to_use(newest_first: Iterable[PhantomScan]) -> str | None:
    """Choose the newest usable phantom scan, unless a schedule has used it: an older one shows the past."""
    for scan in newest_first:
        if scan.state is ScanState.READY and scan.phantom_state is PhantomState.READY:
            return None if scan.is_used else scan.id
    return None


def log_scan_to_check(newest_first: Iterable[LogScan], last_checked_at: datetime | None) -> str | None:
    """Choose the newest log scan that is fit for a drift check.

    An older log than the newest one that a drift check has seen shows the past; that one came at `last_checked_at`.
    """
    for scan in newest_first:
        is_new = not scan.is_checked and (last_checked_at is None or scan.created_at > last_checked_at)
        if is_new and scan.state is ScanState.READY and scan.views >= FEWEST_VIEWS:
            return scan.id
    return None


def missed_due_time(
    first_due_at: datetime, due_at: datetime, outcome: ScheduleOutcome, *, missed_before: bool
) -> tuple[datetime, str] | None:
    """Return the due time that is announced as missed, and why; None where none is.

    A due time before the latest one, `due_at`, has not run. A schedule that keeps missing is announced when that
    begins: not where it was missed at its last due time as well.
    """
    why_nothing = WHY_NOTHING_WAS_QUEUED.get(outcome)
    if first_due_at < due_at:
        later = "" if why_nothing is None else f"; later {why_nothing}"
        return first_due_at, f"nothing ran schedules then{later}"
    return None if why_nothing is None or missed_before else (due_at, why_nothing)
