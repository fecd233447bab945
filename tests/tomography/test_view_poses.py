"""Poses of a log's views: the view of a moved log, and images with the poses that the log shows."""

import argparse

import numpy as np
import pytest
from log_poses import SEED, measure, simulated_log, simulated_views
from scans import GRID, TRUE_THETA
from tests.support.exact_chords import full_turn

from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner
from sawmill_tomography.projection.projector import Projector


def test_views_of_a_moved_log_are_moved_views_of_the_log():
    rng = np.random.default_rng(SEED)
    log, geometry = simulated_log(0, rng), FanBeamGeometry(Scanner(859.46, 384, 3.0), TRUE_THETA, full_turn(20))
    shift_mm, roll_rad = rng.normal(0.0, 4.0, (20, 2)), rng.normal(0.0, 0.007, 20)
    lines, image = simulated_views(log, geometry, shift_mm, roll_rad, rng), log.rasterise(GRID.size, GRID.field_mm)
    views = (geometry, geometry.moved(shift_mm, roll_rad))
    still, moved = (float(np.std(Projector(each, GRID).forward(image) - lines)) for each in views)
    assert moved < 1.1 * 0.02 * np.sqrt(np.mean(lines**2)) < 0.4 * still


@pytest.mark.parametrize(("index", "shift_mm"), [(1, 2.0), (3, 0.0)])
def test_poses_found_give_nearly_the_image_of_true_poses_and_harm_no_log_that_stands_still(index, shift_mm):
    of = measure(index, argparse.Namespace(views=20, size=64, shift_mm=shift_mm, roll_deg=0.5))
    assert of["found"] < min(1.05 * of["true"], (0.95 if shift_mm else 1.02) * of["none"])
    assert of["left_mm"] < 0.2
