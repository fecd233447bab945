"""Which drift checks are points of a chart."""

from datetime import UTC, datetime, timedelta

import pytest

from sawmill_mill.drift_checks import ActiveCalibration, DriftCheck, counts_for_chart
from sawmill_vocabulary import Rotation

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
ACTIVE = ActiveCalibration("active", NOON, Rotation.AS_GIVEN)
COVARIANCE = ((0.0025, -6e-5, 0.0), (-6e-5, 4e-6, 0.0), (0.0, 0.0, 0.0))
CHECK = DriftCheck("active", NOON + timedelta(minutes=1), Rotation.AS_GIVEN, "view-pairs", COVARIANCE, is_counted=False)
# So much that it cannot be inverted any more once it was stored in degrees.
CORRELATED = (
    (7.635460506186958e-05, 5.802928303579087e-05, 0.0),
    (5.802928303579087e-05, 4.410209033128191e-05, 0.0),
    (0.0, 0.0, 0.0),
)


def test_a_check_of_a_later_log_counts_once():
    assert counts_for_chart(CHECK, ACTIVE)
    assert not counts_for_chart(CHECK._replace(is_counted=True), ACTIVE)


@pytest.mark.parametrize(
    "changes",
    [
        {"calibration_id": "another"},
        {"log_came_at": NOON},
        {"rotation": Rotation.REVERSED},
        {"method": None},
        {"covariance": ((0.0,) * 3,) * 3},
        {"covariance": CORRELATED},
    ],
)
def test_what_cannot_be_compared_with_the_others_does_not_count(changes):
    assert not counts_for_chart(CHECK._replace(**changes), ACTIVE)
