"""The chi-square of a small probability, against SciPy's."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import chdtri, ndtri

from sawmill_tomography.calibration.sinogram_data import counted_radius_mm
from sawmill_tomography.geometry.geometry import (
    FanBeamGeometry,
    GeometryError,
    Scanner,
    SourceFrame,
    Theta,
    cell_centres_mm,
    rotate,
    to_vector,
)
from sawmill_tomography.geometry.ray_error import (
    RayAlternatives,
    RayErrorMixture,
    chord_points,
    exceeded_ray_error,
    predicted_ray_error,
    ray_error,
    scale_gradient,
    scale_ray_error,
)
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.statistics import exceeded_chi_square
from sawmill_vocabulary import DetectorModule

R_S = 859.46
DEVIATIONS = np.array([0.0, 0.4, 0.9, 0.05, 0.002])


def test_a_geometry_has_no_error_against_itself_nor_its_twin(scanner, random_thetas):
    for theta in random_thetas(20, 601):
        frame = theta.source_frame(R_S)
        twin = theta.twin(R_S).source_frame(R_S)
        # Rounding of a metre.
        assert ray_error(scanner, frame, frame).max_mm < 1e-9
        assert ray_error(scanner, frame, twin).max_mm < 1e-9


def test_a_common_rotation_is_taken_out(scanner, theta):
    frame = theta.source_frame(R_S)
    other = SourceFrame.from_vector(to_vector(frame) + DEVIATIONS)
    turned = SourceFrame.from_vector(to_vector(other) + np.array([0.3, 0.0, 0.0, 0.0, 0.0]))
    assert ray_error(scanner, frame, turned) == ray_error(scanner, frame, other)
    turned_only = SourceFrame.from_vector(to_vector(frame) + np.array([1.0, 0.0, 0.0, 0.0, 0.0]))
    assert ray_error(scanner, frame, turned_only).rms_mm < 1e-9


def test_a_detector_shifted_by_du_misses_a_small_disc_by_du_over_the_magnification():
    """Every ray turns about the source by du / SDD; the rotation takes out all but R du / SDD of that."""
    true = SourceFrame(0.0, 1000.0, 2000.0, 0.0, 0.0)
    error = ray_error(Scanner(1000.0, 4000, 0.2), true, SourceFrame(0.0, 1000.0, 2000.0, 0.05, 0.0), radius_mm=4.0)
    # The next order: a stretch about a centre off by 0.025 mm of 4, squared and over the mean square of x, 1.2e-4.
    assert error.rms_mm == pytest.approx(0.025, rel=2e-4)
    # That stretch is 0.6 % of the 4 mm at the rim: 3 times 0.025 / 4 of the shift.
    assert error.max_mm == pytest.approx(0.025, rel=2.5e-2)


def test_a_common_scale_is_taken_out_and_reported(scanner, random_thetas):
    """A phantom 1 % larger gives R 1 % larger, with the same SDD, u_c and tau: the same rays, the image enlarged."""
    for theta in random_thetas(5, 604):
        frame = theta.source_frame(R_S)
        error = ray_error(scanner, frame, replace(frame, source_distance_mm=1.01 * frame.source_distance_mm))
        assert error.max_mm < 1e-9
        assert error.scale_change == pytest.approx(0.01, rel=1e-9)


def test_the_scale_change_is_linear_in_a_small_change_of_the_frame(scanner, theta):
    frame = theta.source_frame(R_S)
    gradient = scale_gradient(scanner, frame)
    assert (gradient[0], gradient[1]) == (0.0, pytest.approx(1.0 / frame.source_distance_mm))
    for step in DEVIATIONS * np.eye(5)[1:]:
        other = SourceFrame.from_vector(to_vector(frame) + step)
        # Second order in steps of half a thousandth of the lengths: 1.1 % for the tilt. u_c hardly scales: 2e-5 %.
        assert ray_error(scanner, frame, other).scale_change == pytest.approx(gradient @ step, rel=0.02, abs=2e-7)


def test_a_wrong_scale_moves_the_rays_by_its_share_of_their_distance_from_the_centre(scanner, theta):
    """Of parallel rays that cover a disc of radius r by chords, mean square distance (r^2) / 3: 86.6 mm of 150."""
    frame = theta.source_frame(R_S)
    # The fan weighs rays by the angle between them, not by their distance: 1 %.
    assert scale_ray_error(scanner, frame, 0.001) == pytest.approx(0.0866, rel=0.01)


def distances_by_hand(scanner, true, other, radius, omega, shrink):
    """Nine points of each chord of the true rays, to the other's rays turned by omega, R times shrink."""
    found = []
    source, centre, axis = (v[0] for v in true)
    ends = centre + cell_centres_mm(scanner)[:, None] * axis
    other_source, other_centre, other_axis = (np.stack(rotate(omega, *v[0]), -1) for v in other)
    for end, other_end in zip(ends, other_centre + cell_centres_mm(scanner)[:, None] * other_axis, strict=True):
        d = (end - source) / np.linalg.norm(end - source)
        middle = source - (source @ d) * d
        half_square = radius**2 - middle @ middle
        if half_square > 0.0:
            e = (other_end - other_source) / np.linalg.norm(other_end - other_source)
            off = middle + math.sqrt(half_square) * np.linspace(-1.0, 1.0, 9)[:, None] * d - shrink * other_source
            found.append(e[0] * off[:, 1] - e[1] * off[:, 0])
    return np.array(found)


def test_it_is_the_least_rms_over_one_rotation_and_one_scale_of_point_to_ray_distances(theta):
    scanner = Scanner(R_S, 96, 12.0)
    other = Theta(2.6, 700.0, 300.0, 60.0, 0.25)
    vectors = [FanBeamGeometry(scanner, t, np.zeros(1)).vectors() for t in (theta, other)]

    def distances(free):
        return distances_by_hand(scanner, *vectors, 150.0, *free)

    best = minimize(lambda free: np.mean(distances(free) ** 2), [0.0, 1.0], method="Nelder-Mead", tol=1e-12)
    error = ray_error(scanner, theta.source_frame(R_S), other.source_frame(R_S))
    assert error.rms_mm == pytest.approx(math.sqrt(best.fun), rel=1e-6)
    assert error.max_mm == pytest.approx(np.abs(distances(best.x)).max(), rel=1e-4)
    assert 1.0 + error.scale_change == pytest.approx(1.0 / best.x[1], rel=1e-5)


def test_chord_points_are_nine_equidistant_points_inside_the_disc(scanner, theta):
    points, cells = chord_points(scanner, theta.source_frame(R_S), 150.0)
    assert points.shape == (cells.size, 9, 2)
    np.testing.assert_allclose(np.linalg.norm(points[:, [0, 8]], axis=-1), 150.0, rtol=1e-12)
    np.testing.assert_allclose(np.diff(points, 2, axis=1), 0.0, atol=1e-9)
    # Rays that meet a disc are neighbours.
    assert (np.diff(cells) == 1).all()


def test_a_disc_that_no_ray_meets_is_refused(scanner):
    with pytest.raises(GeometryError, match="no ray of this geometry meets the disc of radius 150 mm"):
        chord_points(scanner, SourceFrame(0.0, 1000.0, 1600.0, 3000.0, 0.0), 150.0)


@pytest.mark.parametrize("seed", range(5))
def test_the_prediction_of_one_small_step_is_its_actual_error(scanner, theta, seed):
    frame = theta.source_frame(R_S)
    step = np.random.default_rng([602, seed]).standard_normal(5) * [1e-4, 0.01, 0.01, 0.005, 1e-5]
    actual = ray_error(scanner, frame, SourceFrame.from_vector(to_vector(frame) + step))
    predicted = predicted_ray_error(scanner, frame, np.outer(step, step))
    # First order in steps of 1e-5 of the lengths, at every fourth point.
    assert predicted.rms_mm == pytest.approx(actual.rms_mm, rel=3e-3)
    assert predicted.max_mm == pytest.approx(actual.max_mm, rel=3e-3)


def test_the_prediction_is_the_mean_square_over_the_covariance(scanner, theta):
    rng = np.random.default_rng(603)
    frame = theta.source_frame(R_S)
    root = rng.standard_normal((5, 5)) * np.array([1e-3, 0.1, 0.1, 0.02, 1e-4])[:, None]
    squares = [
        ray_error(scanner, frame, SourceFrame.from_vector(to_vector(frame) + root @ rng.standard_normal(5))).rms_mm ** 2
        for _ in range(400)
    ]
    predicted = predicted_ray_error(scanner, frame, root @ root.T)
    # The mean of 400 squares of few degrees of freedom scatters by about 7 %: three times that on the square.
    assert predicted.rms_mm**2 == pytest.approx(np.mean(squares), rel=0.21)


def test_an_uncertain_first_angle_or_source_distance_predicts_no_ray_error_but_a_scale(scanner, theta):
    frame = theta.source_frame(R_S)
    assert predicted_ray_error(scanner, frame, np.diag([0.01, 0.0, 0.0, 0.0, 0.0])).rms_mm == 0.0
    covariance = np.diag([0.0, 4.0, 0.0, 0.0, 0.0])
    # Of 2 mm, rounding.
    assert predicted_ray_error(scanner, frame, covariance).rms_mm < 1e-12
    gradient = scale_gradient(scanner, frame)
    assert gradient @ covariance @ gradient == pytest.approx((2.0 / frame.source_distance_mm) ** 2)


def test_drawn_errors_count_in_the_limits_as_their_covariance_does(scanner, theta):
    """The limits come from draws, of which 8192 give the quantile to 1 %; half of the drawn errors are none."""
    frame, rng = theta.source_frame(R_S), np.random.default_rng(613)
    root = rng.standard_normal((5, 2)) * DEVIATIONS[:, None]
    errors = rng.standard_normal((20_000, 2)) @ root.T
    of_noise = np.diag(DEVIATIONS**2)
    apart = predicted_ray_error(scanner, frame, of_noise, mixture=RayErrorMixture(errors, len(errors)))
    together = predicted_ray_error(scanner, frame, of_noise + root @ root.T)
    assert apart.upper_95_mm == pytest.approx(together.upper_95_mm, rel=0.03)
    halved = predicted_ray_error(scanner, frame, of_noise, mixture=RayErrorMixture(errors, 2 * len(errors)))
    noise = predicted_ray_error(scanner, frame, of_noise)
    assert noise.upper_95_mm < halved.upper_95_mm < apart.upper_95_mm
    assert (halved.rms_mm, halved.max_mm) == (noise.rms_mm, noise.max_mm)


@pytest.mark.parametrize(("gap_mm", "kink_rad"), [(0.05, 0.0), (0.0, 0.001), (0.05, 0.001)])
def test_a_hidden_module_that_is_certain_is_the_error_of_its_gap_and_kink(scanner, theta, gap_mm, kink_rad):
    frame, cell = theta.source_frame(R_S), scanner.num_detector_pixels // 3
    hidden = RayAlternatives(
        np.array([cell]), np.array([[gap_mm, kink_rad]]), np.zeros((1, 5)), np.zeros(1, int), np.ones(1), np.ones(1)
    )
    modules = replace(scanner, detector_modules=(DetectorModule(cell, gap_mm, kink_rad),))
    error = ray_error(scanner, frame, frame, other_scanner=modules)
    predicted = predicted_ray_error(scanner, frame, np.zeros((5, 5)), [hidden])
    # Every fourth point of the chords gives the mean square to 1 %.
    assert predicted.upper_95_mm == pytest.approx(error.rms_mm, rel=0.01)


@pytest.mark.parametrize(("gap_mm", "kink_rad"), [(0.5, 0.0), (0.0, 0.02)])
def test_a_known_module_that_begins_elsewhere_is_wrong_in_the_cells_between(scanner, theta, gap_mm, kink_rad):
    """Of two movements of a third of the detector those of the cells between remain, which are far smaller."""
    frame, cell = theta.source_frame(R_S), scanner.num_detector_pixels // 3
    known, true = (
        replace(scanner, detector_modules=(DetectorModule(first, gap_mm, kink_rad),)) for first in (cell, cell + 4)
    )
    changes, steps = np.array([[-gap_mm, kink_rad]]), np.array([[0.0] * 5 + [gap_mm, -kink_rad]])
    elsewhere = RayAlternatives(np.array([cell + 4]), changes, steps, np.zeros(1, int), np.ones(1), np.ones(1))
    predicted = predicted_ray_error(known, frame, np.zeros((7, 7)), [elsewhere])
    error = ray_error(known, frame, frame, other_scanner=true)
    # Every fourth of the points on the four cells' rays; a kink of 0.02 is its sine to first order only.
    assert predicted.upper_95_mm == pytest.approx(error.rms_mm, rel=0.08)


def test_what_few_errors_exceed_is_that_of_one_normal_error_and_that_of_the_draws(scanner, theta):
    """One uncertain parameter has a closed limit; five have draws: both are right to 1 %."""
    frame = theta.source_frame(R_S)
    column = np.diag([0.0, 0.0, 0.0, 0.05, 0.0]) ** 2
    limit = -ndtri(0.5e-4) * predicted_ray_error(scanner, frame, column).rms_mm
    # The prediction is at every fourth point.
    assert exceeded_ray_error(scanner, frame, column, 1e-4) == pytest.approx(limit, rel=1e-3)
    covariance = np.diag(DEVIATIONS**2)
    drawn = predicted_ray_error(scanner, frame, covariance).upper_95_mm
    assert exceeded_ray_error(scanner, frame, covariance, 0.05) == pytest.approx(drawn, rel=0.02)
    assert exceeded_ray_error(scanner, frame, np.zeros((5, 5)), 0.05) == 0.0


@pytest.mark.parametrize("degrees", [1, 1.3, 2, 3, 4.9, 7, 33, 361, 5000])
def test_a_chi_square_is_exceeded_with_its_probability(degrees):
    for probability in (0.5, 0.3, 0.01, 1e-5, 1e-9, 1e-20):
        assert exceeded_chi_square(probability, degrees) == pytest.approx(chdtri(degrees, probability), rel=1e-12)


def test_what_is_no_number_has_no_chi_square():
    assert math.isnan(exceeded_chi_square(math.nan, 3))
    assert math.isnan(exceeded_chi_square(0.01, math.nan))


SMALL = Phantom("disc", (Disc((0.0, 0.0), 35.0), Disc((10.0, 0.0), 5.0, -1.0)))


@pytest.mark.parametrize(
    ("stated_mm", "phantom", "radius_mm"),
    [
        (None, L_SHAPE, 150.0),
        (None, RECTANGLE_WITH_HOLE, 150.0),
        (None, SMALL, 35.0),
        (None, SMALL.moved(3.0, 4.0), 40.0),  # off the rotation centre it reaches further out
        (220.0, SMALL, 220.0),
        (20.0, L_SHAPE, 20.0),
    ],
)
def test_what_is_stated_counts_or_the_phantom_s_reach_up_to_150_mm(stated_mm, phantom, radius_mm):
    assert counted_radius_mm(stated_mm, phantom) == pytest.approx(radius_mm, rel=1e-12)
