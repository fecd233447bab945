"""Opposite rays of a log that moved while it was scanned."""

import numpy as np
import pytest

from sawmill_tomography.drift.opposite_rays.conjugate_rays import conjugate_fit
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_vocabulary import Rotation

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=256, detector_pitch_mm=4.5)
THETA = Theta(0.7, 715.0, 180.0, 30.0, 0.15)
VIEWS, AT = 180, 70


def moved_log(full_turn, by_mm, *, noise, rotation=Rotation.AS_GIVEN, seed=1):
    fan = FanBeamGeometry(SCANNER, THETA, rotation.apply(full_turn(VIEWS)))
    log = LogModel.random(1, radius_mm=120.0).slice_at(185.0)
    before, after = (
        simulate_sinogram(body, fan, noise=noise, seed=seed) for body in (log, log.moved(0.6 * by_mm, 0.8 * by_mm))
    )
    return np.concatenate([before[:AT], after[AT:]])


def movement(full_turn, sinogram, rotation=Rotation.AS_GIVEN):
    frame = THETA.source_frame(SCANNER.source_to_cor_mm)
    return conjugate_fit(SCANNER, sinogram, full_turn(VIEWS), frame, rotation).movement


@pytest.mark.parametrize("rotation", list(Rotation))
def test_a_jump_is_found_at_its_view_with_its_length(full_turn, rotation):
    found = movement(full_turn, moved_log(full_turn, 0.3, noise=0.01, rotation=rotation), rotation)
    assert found.beyond_chance
    assert found.view == pytest.approx(AT, abs=1)
    assert found.by_mm == pytest.approx(0.3, abs=0.02)  # about four standard deviations at 1 % noise


@pytest.mark.slow
def test_a_log_that_stood_still_did_not_jump(full_turn):
    for seed in range(1, 6):
        assert not movement(full_turn, moved_log(full_turn, 0.0, noise=0.005, seed=seed)).beyond_chance
    exact = movement(full_turn, moved_log(full_turn, 0.0, noise=0.0))
    assert exact.by_mm < 0.005
    assert not exact.beyond_chance
