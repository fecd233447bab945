"""A decision of a person closes what came before it, and a discarded attempt closes no earlier result."""

from datetime import UTC, datetime, timedelta

import pytest

from sawmill_mill.alarms import shift_end
from sawmill_mill.decisions import Decisions

NOON = datetime(2026, 3, 2, 12, tzinfo=UTC)
EARLIER, LATER = NOON - timedelta(hours=1), NOON + timedelta(hours=1)


@pytest.mark.parametrize(
    ("decisions", "failure_open", "result_open"),
    [
        (Decisions(), True, True),
        (Decisions(activated_at=NOON), False, False),
        (Decisions(discarded_at=NOON, result_discarded_at=NOON), False, False),
        (Decisions(discarded_at=NOON), False, True),
        (Decisions(activated_at=EARLIER - timedelta(hours=1), discarded_at=NOON), False, True),
    ],
)
def test_a_decision_closes_what_ended_before_it(decisions, failure_open, result_open):
    assert decisions.leave_failure_open(EARLIER) is failure_open
    assert decisions.leave_result_open(EARLIER) is result_open
    assert decisions.leave_failure_open(LATER)
    assert decisions.leave_result_open(LATER)
    assert decisions.leave_result_open(None)


@pytest.mark.parametrize(("hour", "end"), [(5, 6), (6, 14), (13, 14), (14, 22), (22, 30), (23, 30)])
def test_a_shift_ends_at_six_two_and_ten(hour, end):
    assert shift_end(NOON.replace(hour=hour, minute=20 if hour in {5, 13, 23} else 0)) == NOON.replace(
        hour=0
    ) + timedelta(hours=end)
