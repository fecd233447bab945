"""Interpolating between the views of a full turn."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sawmill_worker.tomography.full_turn import periodic_spline
from sawmill_worker.tomography.geometry import TAU


@pytest.mark.parametrize("knots", [2, 3, 20, 97])
def test_the_periodic_spline_is_that_of_scipy(knots):
    rng = np.random.default_rng(knots)
    angles = 5.0 + (np.arange(knots) + rng.uniform(-0.3, 0.3, knots)) * TAU / knots
    values = rng.normal(size=(knots, 4))
    wanted = np.concatenate([angles, rng.uniform(0.0, 3.0 * TAU, 50)])
    oracle = CubicSpline(np.append(angles, angles[0] + TAU), np.append(values, values[:1], axis=0), bc_type="periodic")
    # The systems of equations are small and well conditioned: rounding alone tells the two apart.
    np.testing.assert_allclose(periodic_spline(angles, values, wanted), oracle(wanted), rtol=1e-11, atol=1e-12)
