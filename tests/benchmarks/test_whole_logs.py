import math

import numpy as np
import pytest
from inclusions import NAIL_MM, Inclusion
from scanners import SCANNER
from whole_logs import WholeLog

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram

# The ray to the middle of the detector, between its two middle cells, runs through the centre of rotation.
STRAIGHT = Theta(0.0, 700.0, 0.0, 0.0, 0.0)
GRID = ImageGrid(64, 400.0)


@pytest.fixture(scope="module")
def geometry():
    return FanBeamGeometry(SCANNER, STRAIGHT, np.arange(4) * TAU / 4)


def test_a_body_is_as_long_and_as_wide_as_an_ellipsoid_is(geometry):
    ball = Inclusion("ball", 100.0, (0.0, 0.0), (20.0, 20.0, 10.0), (True, True), 0.3, 0.05)
    for above, radius in ((0.0, 20.0), (6.0, 16.0), (-8.0, 12.0)):
        cut = ball.cut(100.0 + above)
        middle = simulate_sinogram(Phantom("ball", (cut,)), geometry, seed=0)[:, 383:385]
        # 60 corners are a circle to 0.14 %; the cells reach 1 mm from the middle.
        assert middle == pytest.approx(2.0 * radius * 0.05, rel=5e-3)
        assert cut.area_mm2 == pytest.approx(math.pi * radius**2, rel=3e-3)
    assert ball.cut(110.0) is None
    assert ball.cut(89.9) is None


def test_equal_seeds_give_equal_logs_and_the_rows_change_slowly():
    log = WholeLog.random(4000, rows=6)
    assert log == WholeLog.random(4000, rows=6)
    assert log != WholeLog.random(4001, rows=6)
    assert np.allclose(np.diff(log.heights_mm), log.row_pitch_mm)
    truth = log.truth(GRID)
    steps = np.linalg.norm(np.diff(truth, axis=0), axis=(1, 2)) / np.linalg.norm(truth[0])
    assert (steps > 1e-3).all()
    assert (steps < 0.3).all()


@pytest.mark.parametrize("seed", [4000, 4001, 4002])
def test_each_kind_of_log_is_wood_in_air_and_its_data_are_its_integrals(geometry, seed):
    log = WholeLog.random(seed, rows=1)
    truth, data = log.truth(GRID), log.sinograms(geometry, noise=0.0)
    assert truth.min() >= 0.0
    assert not truth[:, :2].any()
    wood = truth[:, 31:33, 31:33].mean()
    assert 0.008 < wood < 0.03
    projected = Projector(geometry, GRID).forward(truth)
    # The truth's area means keep the attenuation of a whole view.
    assert data.sum(axis=-1) == pytest.approx(projected.sum(axis=-1), rel=5e-3)
    noisy = log.sinograms(geometry, noise=0.04) - data
    assert noisy.std() / np.sqrt(np.mean(data**2)) == pytest.approx(0.04, rel=0.1)


def test_the_nail_is_as_long_as_its_name_says():
    log = WholeLog.random(4003, rows=48, row_pitch_mm=0.5)
    nail = next(one for one in log.inclusions if one.name == "nail")
    shown = [nail.cut(nail.height_mm + 0.5 * step) is not None for step in range(-20, 21)]
    assert sum(shown) == pytest.approx(NAIL_MM / 0.5, abs=1)
    share = WholeLog.random(4003, rows=8, row_pitch_mm=4.0).inclusion_alone("nail", GRID)
    assert 1 <= share.any(axis=(1, 2)).sum() <= 3
    assert share.sum() * GRID.pixel_mm**2 == pytest.approx(
        math.pi * nail.half_mm[0] * nail.half_mm[1] * share.any(axis=(1, 2)).sum(), rel=0.15
    )
