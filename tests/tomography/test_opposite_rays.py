"""Opposite rays of a full turn as functions of the geometry and of its disturbances; views interpolated for them."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sawmill_tomography.drift.change import seen_vector
from sawmill_tomography.drift.opposite_rays.disturbances import DISTURBANCES, estimates_of
from sawmill_tomography.drift.opposite_rays.full_turn import FullTurn, even_views, periodic_spline
from sawmill_tomography.drift.opposite_rays.opposite_rays import ALL_THREE, Pairs, Solution
from sawmill_tomography.geometry.geometry import TAU, Scanner, Theta
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=96, detector_pitch_mm=12.0)
FRAME = Theta(0.7, 715.0, 180.0, 30.0, 0.15).source_frame(MILL.source_to_cor_mm)
VECTOR = seen_vector(FRAME)
VIEWS = 60


@pytest.fixture(scope="module")
def pairs(full_turn):
    """Pairs of rays through three discs, of which a view and a few samples are left out."""
    angles = full_turn(VIEWS)
    discs = (Disc((20.0, 10.0), 110.0, 0.01), Disc((60.0, 0.0), 25.0, 0.01), Disc((-40.0, 50.0), 15.0, 0.02))
    rays = project(Phantom("log", discs), DetectorCells.of(MILL), FRAME, angles)
    rays += 0.01 * np.random.default_rng(5).standard_normal(rays.shape)
    usable, bridged, left_out = np.arange(VIEWS) != 7, np.zeros(rays.shape[1], bool), np.zeros(rays.shape, bool)
    left_out[3, 40:44] = True
    turn = FullTurn.of(rays, 0.0, angles, usable=usable, bridged=bridged, left_out=left_out)
    return Pairs(MILL, turn, VECTOR, (1.0, 1.5))


@pytest.fixture(scope="module")
def rays(pairs):
    return pairs.at(VECTOR)


def test_normal_equations_are_sums_over_pairs_and_directions(rays):
    assert 0 < (~rays.used).sum() < rays.used.size
    slopes, instruments = rays.slopes, rays.instruments
    assert not instruments[:, ~rays.used].any()
    noise = (np.einsum("xip,ipt->xpt", rays.weights, each) for each in rays.derivatives[2:])
    gram = np.einsum("xpt,ypt->xy", instruments, slopes)
    # Only the order of the sums differs.
    np.testing.assert_allclose(rays.gram(corrected=False), gram, rtol=1e-12)
    np.testing.assert_allclose(rays.gram(corrected=True), gram - np.einsum("ypt,xpt->xy", *noise), rtol=1e-11)
    scores = np.einsum("xpt,pt->tx", instruments, rays.difference)
    np.testing.assert_allclose(rays.scores, scores, rtol=1e-12, atol=1e-12 * np.abs(scores).max())


def test_a_disturbance_moves_the_rays_as_the_angles_of_their_views_say(pairs, rays):
    solution = Solution(VECTOR, settled=True, pairs=pairs, rays=rays, free_covariance=np.eye(3), free=ALL_THREE)
    estimates = estimates_of(solution)
    assert [each.disturbance for each in estimates] == list(DISTURBANCES)
    for each in estimates:
        # Of each ray the view that measured it.
        here, there = (
            np.stack([np.cos(each.disturbance.order * phi), np.sin(each.disturbance.order * phi)])
            for phi in pairs.views_of()
        )
        by, waves = {"encoder": (1, there - here), "bearing": (0, -here - there)}[each.disturbance.part]
        alone = rays.with_unknowns(solution.derivatives, [by, by], waves)
        value = -np.linalg.solve(alone.gram(corrected=True), alone.scores.sum(axis=0))[3:]
        np.testing.assert_allclose(each.value, value, rtol=1e-9)


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
    even, _ = even_views(rays[order], angles[order], order != 5)
    np.testing.assert_allclose(np.delete(even, 5, axis=0), np.delete(rays, 5, axis=0), rtol=1e-12)
    assert np.abs(even[5] - rays[5]).min() > 0.0
