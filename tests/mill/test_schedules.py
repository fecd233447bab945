"""Which scan a schedule takes, and which due times it announces as missed."""

from datetime import UTC, datetime, timedelta

import pytest

from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_mill.schedules import (
    FEWEST_VIEWS,
    LogScan,
    Missed,
    PhantomScan,
    choose_log_scan,
    choose_phantom_scan,
    missed_due_time,
)

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
SCAN = PhantomScan("newest", ScanState.READY, PhantomState.READY, is_used=False)
LOG = LogScan("newest", NOON, ScanState.READY, FEWEST_VIEWS, is_checked=False)


def test_the_newest_usable_phantom_scan_is_taken():
    unusable = [SCAN._replace(state=ScanState.INGESTING), SCAN._replace(phantom_state=PhantomState.REFUSED)]
    assert choose_phantom_scan([*unusable, SCAN._replace(id="taken"), SCAN]) == ("queued", "taken")


def test_an_older_phantom_scan_than_the_one_that_was_used_shows_the_past():
    assert choose_phantom_scan([SCAN._replace(is_used=True), SCAN]) == ("no-new-phantom-scan", None)
    assert choose_phantom_scan([]) == ("no-new-phantom-scan", None)


@pytest.mark.parametrize(
    "unfit",
    [LOG._replace(state=ScanState.REFUSED), LOG._replace(views=FEWEST_VIEWS - 1), LOG._replace(is_checked=True)],
)
def test_the_newest_log_that_is_fit_is_taken(unfit):
    assert choose_log_scan([unfit, LOG._replace(id="taken"), LOG], None) == ("queued", "taken")


def test_a_log_before_the_last_one_that_was_checked_shows_the_past():
    assert choose_log_scan([LOG], NOON) == ("no-new-log-scan", None)
    assert choose_log_scan([LOG], NOON - timedelta(seconds=1)) == ("queued", "newest")


def test_without_an_active_calibration_there_is_nothing_to_compare_a_log_with():
    assert choose_log_scan([LOG], None, has_active_calibration=False) == ("no-active-calibration", None)


def test_a_schedule_that_keeps_missing_is_announced_when_that_begins():
    why = "there was no new scan of a phantom"
    assert missed_due_time(NOON, NOON, "queued", missed_before=True) is None
    assert missed_due_time(NOON, NOON, "no-new-phantom-scan", missed_before=False) == (NOON, why)
    assert missed_due_time(NOON, NOON, "no-new-phantom-scan", missed_before=True) is None


@pytest.mark.parametrize(
    ("outcome", "later"), [("queued", ""), ("no-new-phantom-scan", "; later there was no new scan of a phantom")]
)
def test_due_times_while_nothing_ran_are_announced_whatever_was_before(outcome, later):
    missed = missed_due_time(NOON, NOON + timedelta(days=7), outcome, missed_before=True)
    assert missed == Missed(NOON, f"nothing ran schedules then{later}")
