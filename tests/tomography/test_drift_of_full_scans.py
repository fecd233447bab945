"""Drift checks of many views around a turn that is not what the angles say: pairs of views fit it."""

import pytest
from production_logs import checked, production

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("one_thread")]


def test_a_wrong_turn_of_many_views_costs_no_certainty():
    """The 360 views stand over 363 degrees; opposite rays alone were 0.41 mm off, and knew u_c to 0.22 mm."""
    answer = checked(production("short turn", 8))
    # 45 of the views, 60 rows of 30 000 photons: a standard deviation of 0.01 mm.
    assert answer["deviation_mm"] < 0.02
    assert abs(answer["error_mm"]) < 3.0 * answer["deviation_mm"]
