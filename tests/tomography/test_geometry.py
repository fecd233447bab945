import math

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import (
    TAU,
    FanBeamGeometry,
    GeometryError,
    Scanner,
    SourceFrame,
    Theta,
    ThetaBounds,
    angle_difference,
    bounds_array,
    cell_borders_mm,
    cell_centres_mm,
    rotate,
    to_vector,
    view_weights,
    wrap_angle,
)
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells

R_S = 859.46


def test_theta_to_source_frame_and_back_closes_for_both_signs_of_the_source_shift(random_thetas):
    for theta in random_thetas(500, 101):
        back = theta.source_frame(R_S).theta(R_S, source_shift_sign=1 if theta.source_shift_mm >= 0.0 else -1)
        lengths = to_vector(back)[1:4] - to_vector(theta)[1:4]
        # 1e-12 of the metre that the lengths are of; h_S alone comes out of a difference of squares, which
        # magnifies the rounding of R by R / h_S.
        allowed = 1e-12 * 1000.0 * max(1.0, 1000.0 / abs(theta.source_shift_mm))
        assert np.abs(lengths).max() < allowed
        assert abs(angle_difference(back.initial_angle_rad, theta.initial_angle_rad)) < allowed / 1000.0
        assert math.atan(back.detector_tilt) == pytest.approx(math.atan(theta.detector_tilt), abs=allowed / 1000.0)


def test_the_source_frame_describes_the_same_rays_as_theta(scanner, theta):
    geometry = FanBeamGeometry(scanner, theta, np.array([0.3, 4.1]))
    frame = geometry.frame
    source, centre, axis = geometry.vectors()
    cells = centre[:, None, :] + cell_centres_mm(scanner)[None, :, None] * axis[:, None, :]
    for view, angle in enumerate(geometry.angles_rad):
        beta = angle + frame.psi_rad
        w = cell_centres_mm(scanner) - frame.cor_column_mm
        across = w * math.cos(frame.tilt_rad)
        depth = frame.source_to_detector_mm - frame.source_distance_mm + w * math.sin(frame.tilt_rad)
        # Positions are of a metre: 1e-9 mm leaves a hundred roundings.
        np.testing.assert_allclose(np.stack(rotate(beta, across, depth), -1), cells[view], atol=1e-9)
        np.testing.assert_allclose(rotate(beta, 0.0, -frame.source_distance_mm), source[view], atol=1e-9)


def test_vectors_place_the_source_the_detector_and_its_slope_as_the_conventions_page_has_it(scanner):
    theta = Theta(0.0, 700.0, 30.0, 40.0, 0.5)
    source, centre, axis = FanBeamGeometry(scanner, theta, np.array([0.0, math.pi / 2.0])).vectors()
    np.testing.assert_allclose(source, [(30.0, -R_S), (R_S, 30.0)], atol=1e-12 * R_S)
    np.testing.assert_allclose(centre, [(-40.0, 700.0), (-700.0, -40.0)], atol=1e-12 * R_S)
    np.testing.assert_allclose(axis[0], np.array([1.0, 0.5]) / math.sqrt(1.25), atol=1e-15)


def test_the_twin_has_the_same_frame_and_the_same_sinogram(scanner, theta, full_turn):
    twin = theta.twin(R_S)
    assert twin.source_shift_mm == -theta.source_shift_mm
    cells, angles = DetectorCells.of(scanner), full_turn(12)
    other = analytic.project(L_SHAPE, cells, twin.source_frame(R_S), angles)
    # Chords are up to 350 mm and the frames agree to rounding.
    np.testing.assert_allclose(other, analytic.project(L_SHAPE, cells, theta.source_frame(R_S), angles), atol=1e-9)


def test_the_twin_of_the_twin_is_theta_itself(random_thetas):
    for theta in random_thetas(200, 102):
        np.testing.assert_allclose(to_vector(theta.twin(R_S).twin(R_S)), to_vector(theta), rtol=1e-11, atol=1e-9)


def test_a_source_frame_at_the_known_distance_has_no_source_shift_and_a_nearer_one_no_theta():
    theta = SourceFrame(1.0, R_S, 1600.0, 20.0, 0.1).theta(R_S)
    assert (theta.source_shift_mm, theta.initial_angle_rad) == (0.0, pytest.approx(1.0, abs=1e-15))
    frame = SourceFrame(0.0, R_S - 0.1, 1600.0, 0.0, 0.0)
    with pytest.raises(GeometryError, match=r"source_distance_mm 859\.36 is smaller than source_to_cor_mm 859\.46"):
        frame.theta(R_S)


@pytest.mark.parametrize(
    ("theta", "says"),
    [
        (Theta(0.0, 700.0, R_S, 0.0, -1.0), "lays the detector along the ray"),
        (Theta(0.0, -900.0, 0.0, 0.0, 0.0), "behind the source"),
    ],
)
def test_a_theta_without_a_source_frame_is_refused(theta, says):
    with pytest.raises(GeometryError, match=says):
        theta.source_frame(R_S)


def test_turning_the_phantom_and_the_scanner_together_changes_nothing(scanner, theta, full_turn):
    cells, angles = DetectorCells.of(scanner), full_turn(9)
    frame = theta.source_frame(R_S)
    turned = SourceFrame.from_vector(to_vector(frame) + np.array([0.7, 0, 0, 0, 0]))
    by_both = analytic.project(L_SHAPE.rotated(0.7), cells, turned, angles)
    np.testing.assert_allclose(by_both, analytic.project(L_SHAPE, cells, frame, angles), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, -0.0, 1.0, -1.0, TAU, -TAU, -1e-20, 1e-20, 7.5 * TAU, -1e6, math.pi])
def test_a_wrapped_angle_is_in_the_turn_and_points_the_same_way(angle):
    wrapped = wrap_angle(angle)
    assert 0.0 <= wrapped < TAU
    # One rounding of the angle's own size.
    tolerance = 4e-16 * max(1.0, abs(angle))
    assert abs(math.cos(wrapped) - math.cos(angle)) <= 2.0 * tolerance
    assert abs(math.sin(wrapped) - math.sin(angle)) <= 2.0 * tolerance


def test_angle_difference_takes_the_short_way_round():
    assert angle_difference(0.1, TAU - 0.1) == pytest.approx(0.2, abs=1e-15)
    assert angle_difference(TAU - 0.1, 0.1) == pytest.approx(-0.2, abs=1e-15)


def test_vectors_of_theta_and_of_the_frame_close_the_loop(random_thetas):
    for theta in random_thetas(20, 105):
        assert Theta.from_vector(to_vector(theta)) == theta
        frame = theta.source_frame(R_S)
        assert SourceFrame.from_vector(to_vector(frame)) == frame
        assert frame.magnification == frame.source_to_detector_mm / frame.source_distance_mm


def test_cells_are_centred_on_the_detector():
    scanner = Scanner(500.0, 5, 2.0)
    np.testing.assert_array_equal(cell_centres_mm(scanner), [-4.0, -2.0, 0.0, 2.0, 4.0])
    np.testing.assert_array_equal(cell_borders_mm(scanner), [-5.0, -3.0, -1.0, 1.0, 3.0, 5.0])


@pytest.mark.parametrize(
    ("constants", "says"),
    [
        ((0.0, 768, 1.5), "source_to_cor_mm must be a positive number of millimetres, not 0.0"),
        ((math.nan, 768, 1.5), "source_to_cor_mm"),
        ((859.0, 768, -1.5), "detector_pitch_mm"),
        ((859.0, 768, math.inf), "detector_pitch_mm"),
        ((859.0, 1, 1.5), "num_detector_pixels must be at least 2, not 1"),
    ],
)
def test_a_scanner_that_cannot_be_is_refused(constants, says):
    with pytest.raises(GeometryError, match=says):
        Scanner(*constants)


@pytest.mark.parametrize("angles", [[], [[0.0, 1.0]], [0.0, math.nan], [0.0, math.inf]])
def test_angles_that_are_no_list_of_numbers_are_refused(scanner, theta, angles):
    with pytest.raises(GeometryError, match="one finite number of radians for each view"):
        FanBeamGeometry(scanner, theta, np.array(angles))


def test_bounds_hold_what_is_inside_leave_the_first_angle_free_and_are_refused_where_empty(theta):
    bounds = ThetaBounds()
    assert bounds.contain(theta)
    assert bounds.contain(Theta.from_vector([99.0, *to_vector(theta)[1:]]))
    assert not bounds.contain(Theta.from_vector([*to_vector(theta)[:4], 1.01]))
    np.testing.assert_array_equal(bounds_array(bounds)[0], [0.0, TAU])
    with pytest.raises(GeometryError, match="the bounds of detector_tilt"):
        ThetaBounds(detector_tilt=(0.5, 0.5))


def test_view_weights_of_equal_steps_are_the_step_and_shared_by_a_view_taken_twice(full_turn):
    np.testing.assert_allclose(view_weights(full_turn(360)), TAU / 360, rtol=1e-12)
    angles = full_turn(20)
    weights = view_weights(np.append(angles, angles[4]))
    assert weights.sum() == pytest.approx(TAU, rel=1e-14)
    assert weights[4] + weights[20] == pytest.approx(TAU / 20, rel=1e-12)


def test_view_weights_fill_the_turn_whatever_the_order_and_the_turn(irregular_turn):
    angles = irregular_turn(77, 106)
    weights = view_weights(angles)
    assert weights.sum() == pytest.approx(TAU, rel=1e-14)
    assert (weights > 0.0).all()
    order = np.random.default_rng(107).permutation(77)
    np.testing.assert_allclose(view_weights(angles[order] + 3.0 * TAU), weights[order], atol=1e-13)


@pytest.mark.parametrize(
    "angles",
    [
        np.linspace(0.0, math.pi, 90),
        np.delete(np.arange(360) * TAU / 360, np.arange(40, 46)),
        np.array([0.0, 1.0]),
        np.zeros(12),
    ],
    ids=["half a turn", "a gap of seven steps", "two views", "one angle twelve times"],
)
def test_views_that_do_not_go_round_are_refused(angles):
    with pytest.raises(GeometryError, match="all round the full turn"):
        view_weights(angles)


def test_a_gap_of_five_steps_is_still_a_full_turn():
    angles = np.delete(np.arange(360) * TAU / 360, np.arange(40, 44))
    assert view_weights(angles).max() == pytest.approx(3.0 * TAU / 360, rel=1e-12)
