import math

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.sinograms.air import find_air
from sawmill_vocabulary import AirCorrection

VIEWS = 90


@pytest.fixture(scope="module")
def clean(scanner, theta, full_turn):
    """A log's sinogram (views, cells) float32, 5 deep."""
    geometry = FanBeamGeometry(scanner, theta, full_turn(VIEWS))
    body = LogModel.random(31).slice_at(60.0)
    return analytic.project(
        body, DetectorCells.of(scanner), geometry.frame, geometry.angles_rad, rays_per_cell=2
    ).astype(np.float32)


def noisy(clean, noise, seed):
    return clean + noise * np.random.default_rng(seed).standard_normal(clean.shape).astype(np.float32)


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.02, 0.05])
def test_air_is_found_by_itself_up_to_the_object_and_never_in_it(clean, noise):
    truth = clean.max(axis=0) <= 0.0
    air = find_air(noisy(clean, noise, 1))
    # A shadow's foot below the noise and the margin of three cells at two ends are given away.
    assert air.cells.sum() > truth.sum() - 20
    assert not (air.cells & ~truth).any()
    assert air.noise == pytest.approx(noise, rel=0.1)


def test_levels_of_views_are_found_within_their_noise(clean):
    drift = 0.03 * np.random.default_rng(2).standard_normal((VIEWS, 1)).astype(np.float32)
    air = find_air(noisy(clean, 0.02, 3) + drift + np.float32(0.1))
    assert air.drifts
    expected = 0.1 + drift[:, 0]
    # Five standard deviations of a mean over the cells found.
    np.testing.assert_allclose(air.level, expected, atol=5.0 * 0.02 / math.sqrt(air.cells.sum()))
    np.testing.assert_allclose(air.correction(AirCorrection.VIEWS)[:, 0], air.level, rtol=1e-6)
    np.testing.assert_allclose(air.correction(AirCorrection.BACKGROUND), air.level.mean(), rtol=1e-6)
    assert not air.correction(AirCorrection.OFF).any()


def test_a_steady_source_gets_one_constant_and_an_object_at_one_end_is_measured_at_the_other(clean):
    air = find_air(noisy(clean, 0.02, 4) + np.float32(0.1))
    assert not air.drifts
    assert np.ptp(air.correction(AirCorrection.VIEWS)) == 0.0
    assert air.background == pytest.approx(0.1, abs=5.0 * 0.02 / math.sqrt(VIEWS * air.cells.sum()))
    air = find_air(noisy(clean[:, np.flatnonzero(clean.max(axis=0) > 0.0)[0] + 60 :], 0.01, 5))
    assert not air.cells[:60].any()
    assert air.cells[-30:].all()
    assert abs(air.background) < 0.001


def test_a_detector_filled_by_the_object_has_no_air_and_unequal_cells_are_no_object(clean):
    covered = np.flatnonzero(clean.max(axis=0) > 0.0)
    assert find_air(noisy(clean[:, covered[0] + 40 : covered[-1] - 40], 0.01, 6)) is None
    unequal = 0.02 * np.random.default_rng(7).standard_normal(clean.shape[1]).astype(np.float32)
    assert find_air(noisy(clean, 0.01, 8) + unequal).cells.sum() > 0.8 * (clean.max(axis=0) <= 0.0).sum()
