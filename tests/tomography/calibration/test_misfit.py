import math

import numpy as np
import pytest

from sawmill_tomography.calibration.search.misfit import CoarseMisfit, search_box
from sawmill_tomography.geometry.geometry import ThetaBounds, angle_difference
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Handedness, Rotation

BOTH = {Handedness.AS_DRAWN: L_SHAPE, Handedness.FROM_BEHIND: L_SHAPE.mirrored()}


@pytest.fixture
def frame(theta, scanner):
    return theta.source_frame(scanner.source_to_cor_mm)


def start_of(frame):
    return np.array([frame.source_distance_mm, math.log(frame.magnification), frame.cor_column_mm, frame.tilt_rad])


@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize("rotation", list(Rotation))
def test_the_truth_correlates_fully_under_its_own_hypothesis_alone(scanner, frame, full_turn, handedness, rotation):
    cells, angles = DetectorCells.of(scanner, binned=12), full_turn(40)
    # Gain and background drop out.
    sinogram = 4.0 + 0.1 * analytic.project(BOTH[handedness], cells, frame, rotation.apply(angles))
    candidates = CoarseMisfit(BOTH, tuple(Rotation), sinogram, angles, cells)(start_of(frame))
    assert len(candidates) == 4
    truth = candidates.pop((handedness, rotation))
    # The table has a turn every 3 degrees, and the views are rounded to it too.
    assert truth.misfit < 0.01
    assert abs(angle_difference(truth.frame.psi_rad, frame.psi_rad)) <= math.radians(3.0)
    assert min(candidate.misfit for candidate in candidates.values()) > 5.0 * truth.misfit


def test_the_box_holds_every_frame_that_the_bounds_allow(scanner, random_thetas):
    box = search_box(scanner, ThetaBounds(), L_SHAPE)
    half = 0.5 * scanner.num_detector_pixels * scanner.detector_pitch_mm
    # The box is read off a grid of 13 points a side: its ends may miss a corner by a step.
    slack = 0.1 * (box[:, 1] - box[:, 0])
    inside = 0
    for theta in random_thetas(300, 1603):
        frame = theta.source_frame(scanner.source_to_cor_mm)
        if abs(frame.cor_column_mm) < half and analytic.clears(L_SHAPE.radius_mm, frame):
            inside += 1
            start = start_of(frame)
            assert ((start >= box[:, 0] - slack) & (start <= box[:, 1] + slack)).all()
    assert inside > 100
