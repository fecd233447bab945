"""Poses of a log's views: what a view of a moved log is, and images with the poses that the log itself shows."""

import argparse

import numpy as np
import pytest
from log_poses import LEAST_ROLL_RAD, SEED, measure, simulated_log, simulated_views
from scans import TRUE_THETA
from tests.support.exact_chords import full_turn

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, Scanner
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.view_poses import LEAST_VIEWS, find_view_poses

SMALL = {"views": 20, "size": 64, "roll_deg": 0.5}


def test_views_of_a_moved_log_are_moved_views_of_the_log_and_few_views_show_no_poses():
    rng = np.random.default_rng(SEED)
    log, geometry = simulated_log(0, rng), FanBeamGeometry(Scanner(859.46, 384, 3.0), TRUE_THETA, full_turn(20))
    shift_mm, roll_rad = rng.normal(0.0, 4.0, (20, 2)), rng.normal(0.0, 8.0 * LEAST_ROLL_RAD, 20)
    lines, grid = simulated_views(log, geometry, shift_mm, roll_rad, rng), ImageGrid(256, 400.0)
    image = log.rasterise(grid.size, grid.field_mm)
    still, moved = (
        float(np.std(Projector(views, grid).forward(image) - lines))
        for views in (geometry, geometry.moved(shift_mm, roll_rad))
    )
    assert moved < 1.1 * 0.02 * np.sqrt(np.mean(lines**2)) < 0.4 * still
    few = slice(0, LEAST_VIEWS - 1)
    with pytest.raises(GeometryError, match="poses of 7 views"):
        find_view_poses(geometry.at(few), lines[None, few])


@pytest.mark.parametrize(("index", "shift_mm"), [(1, 2.0), (3, 0.0)])
def test_poses_found_give_nearly_the_image_of_true_poses_and_harm_no_log_that_stands_still(index, shift_mm):
    of = measure(index, argparse.Namespace(shift_mm=shift_mm, **SMALL))
    assert of["found"] < 1.05 * of["true"]
    assert of["found"] < (0.95 if shift_mm else 1.02) * of["none"]
    assert of["left_mm"] < 0.2
