"""What a schedule takes and announces, which calibrations activate themselves, and which drift checks a chart has."""

from datetime import UTC, datetime, timedelta

import pytest

from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_mill.scanner_state import DriftCheck, activation_reason, counts_for_chart
from sawmill_mill.schedules import FEWEST_VIEWS, LogScan, PhantomScan, log_scan_to_check, phantom_scan_to_use
from sawmill_vocabulary import DetectorEstimate, Rotation

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
SCAN = PhantomScan("newest", ScanState.READY, PhantomState.READY, is_used=False)
LOG = LogScan("newest", NOON, ScanState.READY, FEWEST_VIEWS, is_checked=False)


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


PASSED = {"wanted": True, "schedule_id": None, "rays_verdict": "pass", "has_moved": False}


@pytest.mark.parametrize(
    ("changes", "asker"),
    [
        ({}, "the request"),
        ({"has_moved": True}, "the request"),
        ({"schedule_id": "daily"}, "schedule daily"),
        ({"schedule_id": "daily", "has_moved": True}, None),
        ({"wanted": False}, None),
        ({"rays_verdict": "watch"}, None),
        ({"rays_verdict": "fail"}, None),
    ],
)
def test_a_pass_activates_itself_where_it_was_asked_for_unless_a_schedule_finds_the_scanner_moved(changes, asker):
    reason = None if asker is None else f"the rays pass; {asker} asked for activation on pass"
    assert activation_reason(**PASSED | changes) == reason


CHECK = DriftCheck(
    calibration_id="active",
    active_id="active",
    log_came_at=NOON + timedelta(minutes=1),
    phantom_came_at=NOON,
    rotation=Rotation.AS_GIVEN,
    active_rotation=Rotation.AS_GIVEN,
    method="view-pairs",
    change=DetectorEstimate(0.1, 0.001, ((0.0025, -6e-5), (-6e-5, 4e-6))),
    is_counted=False,
)
# Rounding decides whether these can be inverted.
CORRELATED = ((7.635460506186958e-05, 5.802928303579087e-05), (5.802928303579087e-05, 4.410209033128191e-05))


@pytest.mark.parametrize(
    ("changes", "counts"),
    [
        ({}, True),
        ({"is_counted": True}, False),
        ({"calibration_id": "another"}, False),
        ({"log_came_at": NOON}, False),
        ({"rotation": Rotation.REVERSED}, False),
        ({"method": None}, False),
        ({"change": DetectorEstimate(0.1, 0.001, ((0.0, 0.0), (0.0, 0.0)))}, False),
        ({"change": DetectorEstimate(0.1, 0.001, CORRELATED)}, False),
    ],
)
def test_a_check_of_a_later_log_counts_once_if_it_can_be_compared_with_the_others(changes, counts):
    assert counts_for_chart(CHECK._replace(**changes)) is counts
