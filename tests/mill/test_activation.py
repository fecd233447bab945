"""Which calibrations become active by themselves."""

import pytest

from sawmill_mill.activation import FinishedCalibration, activation_reason

PASSED = FinishedCalibration(activates=True, schedule_id=None, rays_verdict="pass", has_moved=False)


def test_a_pass_activates_where_it_was_asked_for_and_says_by_whom():
    assert activation_reason(PASSED) == "the rays pass; the request asked for activation on pass"
    scheduled = activation_reason(PASSED._replace(schedule_id="daily"))
    assert scheduled == "the rays pass; schedule daily asked for activation on pass"


@pytest.mark.parametrize(
    "changes",
    [
        {"activates": False},
        {"rays_verdict": "watch"},
        {"rays_verdict": "fail"},
        {"schedule_id": "daily", "has_moved": True},
    ],
)
def test_nothing_else_activates_itself(changes):
    assert activation_reason(PASSED._replace(**changes)) is None


def test_a_request_may_take_over_a_scanner_that_has_moved():
    assert activation_reason(PASSED._replace(has_moved=True))
