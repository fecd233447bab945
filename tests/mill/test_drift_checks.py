"""Which drift checks are points of a chart."""

from datetime import UTC, datetime, timedelta

import pytest

from sawmill_mill.scanner_state import DriftCheck, counts_for_chart
from sawmill_vocabulary import DetectorEstimate, Rotation

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
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
