"""Which scan a schedule takes, and which due times it announces as missed."""

from datetime import UTC, datetime, timedelta

import pytest

from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_mill import schedules
from sawmill_mill.schedules import FEWEST_VIEWS, LogScan, PhantomScan, log_scan_to_check, phantom_scan_to_use

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
SCAN = PhantomScan("newest", ScanState.READY, PhantomState.READY, is_used=False)
LOG = LogScan("newest", NOON, ScanState.READY, FEWEST_VIEWS, is_checked=False)
WHY = "there was no new scan of a phantom"


def test_the_newest_usable_phantom_scan_is_taken_once():
    unusable = [SCAN._replace(state=ScanState.INGESTING), SCAN._replace(phantom_state=PhantomState.REFUSED)]
    assert phantom_scan_to_use([*unusable, SCAN._replace(id="taken"), SCAN]) == "taken"
    assert phantom_scan_to_use([*unusable, SCAN._replace(is_used=True), SCAN]) is None, "an older one shows the past"
    assert phantom_scan_to_use([]) is None


@pytest.mark.parametrize(
    "unfit",
    [LOG._replace(state=ScanState.REFUSED), LOG._replace(views=FEWEST_VIEWS - 1), LOG._replace(is_checked=True)],
)
def test_the_newest_log_that_is_fit_is_taken(unfit):
    assert log_scan_to_check([unfit, LOG._replace(id="taken"), LOG], None) == "taken"


def test_a_log_before_the_last_one_that_was_checked_shows_the_past():
    assert log_scan_to_check([LOG], NOON) is None
    assert log_scan_to_check([LOG], NOON - timedelta(seconds=1)) == "newest"


@pytest.mark.parametrize(
    ("late", "outcome", "missed_before", "announced"),
    [
        (False, "queued", True, None),
        (False, "no-new-phantom-scan", False, WHY),
        (False, "no-new-phantom-scan", True, None),
        (True, "queued", True, "nothing ran schedules then"),
        (True, "no-new-phantom-scan", True, f"nothing ran schedules then; later {WHY}"),
    ],
)
def test_a_schedule_that_keeps_missing_is_announced_when_that_begins(late, outcome, missed_before, announced):
    due_at = NOON + timedelta(days=7 * late)
    missed = schedules.missed_due_time(NOON, due_at, outcome, missed_before=missed_before)
    assert missed == (None if announced is None else (NOON, announced))
