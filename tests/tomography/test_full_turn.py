"""Interpolating between the views of a full turn."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sawmill_tomography.drift.opposite_rays.full_turn import even_views, periodic_spline
from sawmill_tomography.geometry.geometry import TAU


@pytest.mark.parametrize("knots", [2, 3, 20, 97])
def test_the_periodic_spline_is_that_of_scipy(knots):
    rng = np.random.default_rng(knots)
    angles = 5.0 + (np.arange(knots) + rng.uniform(-0.3, 0.3, knots)) * TAU / knots
    values = rng.normal(size=(knots, 4))
    wanted = np.concatenate([angles, rng.uniform(0.0, 3.0 * TAU, 50)])
    oracle = CubicSpline(np.append(angles, angles[0] + TAU), np.append(values, values[:1], axis=0), bc_type="periodic")
    # The systems of equations are small and well conditioned: rounding alone tells the two apart.
    np.testing.assert_allclose(periodic_spline(angles, values, wanted), oracle(wanted), rtol=1e-11, atol=1e-12)


def test_views_at_even_steps_are_not_interpolated():
    rng = np.random.default_rng(1)
    angles, rays = 0.3 + np.arange(20) * TAU / 20, rng.normal(size=(20, 4))
    order = rng.permutation(20)
    even, first = even_views(rays[order], angles[order], np.ones(20, bool))
    assert first == angles[0]
    np.testing.assert_array_equal(even, rays)
    # A lost view is: the others stay as they are.
    usable = order != 5
    even, _ = even_views(rays[order], angles[order], usable)
    np.testing.assert_allclose(np.delete(even, 5, axis=0), np.delete(rays, 5, axis=0), rtol=1e-12)
    assert np.abs(even[5] - rays[5]).min() > 0.0
