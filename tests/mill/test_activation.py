"""Which calibrations become active by themselves."""

import pytest

from sawmill_mill.scanner_state import activation_reason

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
