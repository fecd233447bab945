"""Frames of fixed pairs moved together, and the distance between the rays of two geometries."""

import numpy as np
import pytest
from fixed_pairs import pair_ray_error
from tests.support.exact_chords import Detector

from sawmill_tomography.geometry.geometry import GeometryError, SourceFrame, rotate
from sawmill_tomography.pairs.passages import by_pose, moved_frames, seen_by_views
from sawmill_tomography.pairs.ray_errors import PairRays
from sawmill_vocabulary import Scanner

CELLS, PITCH_MM = 768, 1.2
SCANNER = Scanner(860.0, CELLS, PITCH_MM)
FRAMES = np.array(
    [[0.3, 860.0, 1570.0, 12.0, 0.05], [1.9, 790.0, 1480.0, -20.0, -0.04], [-2.0, 905.0, 1610.0, 3.0, 0.0]]
)
RAYS = PairRays([SCANNER] * 3, FRAMES, 120.0)


def in_the_hall(frame: np.ndarray) -> np.ndarray:
    """The source, then the middles of the cells, (1 + cells, 2), by the definition of the source frame."""
    psi, distance = frame[:2]
    cells = Detector(CELLS, PITCH_MM).points(SourceFrame.from_vector(frame), 1)[:, 0]
    return np.stack(rotate(psi, *(np.concatenate([[[0.0, 0.0]], cells]) - [0.0, distance]).T), -1)


def test_moved_frames_are_the_moved_sources_and_cells_and_come_back():
    motion = np.array([14.0, -23.0, 0.7])
    moved = moved_frames(FRAMES, motion)
    for before, after in zip(FRAMES, moved, strict=True):
        turned = np.stack(rotate(motion[2], *in_the_hall(before).T), -1)
        np.testing.assert_allclose(in_the_hall(after), turned + motion[:2], atol=1e-9)
    back = moved_frames(moved, [*-np.stack(rotate(-motion[2], *motion[:2])), -motion[2]])
    np.testing.assert_allclose(np.exp(1j * back[:, [0, 4]]), np.exp(1j * FRAMES[:, [0, 4]]), atol=1e-12)
    np.testing.assert_allclose(back[:, 1:4], FRAMES[:, 1:4], atol=1e-9)


def test_derivatives_by_the_pose_are_those_of_central_differences():
    rng = np.random.default_rng(52)
    poses, by_angle, by_position = rng.normal(0.0, 3.0, (5, 3)), rng.normal(size=5), rng.normal(size=(2, 5))

    def linear(poses):
        angles, positions = seen_by_views(poses)
        return by_angle * angles + (by_position.T * positions).sum(axis=1)

    steps = 1e-6 * np.eye(3)
    differences = [(linear(poses + step) - linear(poses - step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(by_pose(poses, by_angle, by_position), differences, atol=1e-7)


def test_a_common_motion_and_a_common_scale_cost_nothing_and_the_scale_is_told():
    larger = FRAMES * [1.0, 1.01, 1.0, 1.0, 1.0]  # each detector stays as far from its source
    error = pair_ray_error(RAYS, moved_frames(larger, [31.0, -8.0, 2.5]))
    assert error.rms_mm < 1e-8
    assert error.scale_change == pytest.approx(0.01, rel=1e-6)


def test_a_column_that_is_off_costs_what_a_hand_calculation_gives():
    # Three pairs 120 degrees apart: 2 mm on one detector move its rays by 2 R / SDD at the centre. The best common
    # shift takes two thirds of the power of (1, 0, 0), as the three normals are a tight frame: the RMS is a third.
    frames = np.array([[turn, 800.0, 1600.0, 0.0, 0.0] for turn in np.deg2rad([0.0, 120.0, 240.0])])
    off = frames + np.array([[0.0, 0.0, 0.0, 2.0, 0.0], [0.0] * 5, [0.0] * 5])
    error = pair_ray_error(PairRays([SCANNER] * 3, frames, 15.0), off)
    assert error.rms_mm == pytest.approx(2.0 * 800.0 / 1600.0 / 3.0, rel=0.01)
    assert error.of_pairs_mm == pytest.approx([1.0 / 3.0] * 3, rel=0.02)


def test_the_predicted_error_is_that_of_draws_from_the_covariance():
    rng = np.random.default_rng(7)
    root = rng.normal(size=(15, 15)) * np.tile([2e-4, 0.3, 0.3, 0.3, 2e-4], 3)[:, None]
    drawn = rng.normal(size=(300, 15)) @ root.T
    errors = [pair_ray_error(RAYS, FRAMES + off.reshape(3, 5)) for off in drawn]
    predicted = RAYS.predicted(root @ root.T)
    squares = np.array([[error.rms_mm, *error.of_pairs_mm, error.scale_change] for error in errors]) ** 2
    of_pairs = [RAYS.predicted(root @ root.T, pair).rms_mm for pair in range(3)]
    expected = [predicted.rms_mm, *of_pairs, RAYS.scale_deviation(root @ root.T)]
    np.testing.assert_allclose(np.sqrt(squares.mean(axis=0)), expected, rtol=0.1)
    assert np.mean(squares[:, 0] > predicted.upper_95_mm**2) == pytest.approx(0.05, abs=0.025)


def test_what_moves_all_pairs_alike_is_no_uncertainty_of_a_pair():
    motion, steps = np.array([5.0, -3.0, 0.2]), np.diag([1e-3, 1e-3, 1e-6])
    rigid = np.array([(moved_frames(FRAMES, step) - moved_frames(FRAMES, -step)).ravel() for step in steps])
    rays = PairRays([SCANNER] * 3, moved_frames(FRAMES, motion), 120.0)
    alone = np.zeros(15)
    alone[2] = 1e-3  # one distance to a detector
    kept, of_one = (np.diag(rays.without_motion(each, motion, FRAMES)) for each in (rigid.T @ rigid, np.diag(alone**2)))
    assert kept.max() < 1e-6 * (rigid**2).max()
    assert of_one[2] == pytest.approx(alone[2] ** 2, rel=0.1)


def test_a_pair_whose_rays_miss_the_log_is_refused_by_its_number():
    away = FRAMES + np.array([[0.0] * 5, [0.0, 0.0, 0.0, 900.0, 0.0], [0.0] * 5])
    with pytest.raises(GeometryError, match="no ray of pair 2 meets the disc of radius 120 mm"):
        pair_ray_error(PairRays([SCANNER] * 3, away, 120.0), FRAMES)
