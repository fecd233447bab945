"""Whole logs, as the table of methods has them."""

import numpy as np
import pytest
from log_scans import LogScan, whole_scan
from scanners import SCANNER
from whole_logs import WholeLog

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector

GRID = ImageGrid(32, 400.0)


@pytest.fixture(scope="module")
def scan():
    log = WholeLog.random(4000, rows=5, row_pitch_mm=4.0)
    return whole_scan(log, log.truth(GRID), 12, 0.02, GRID)


def test_an_image_of_the_truth_has_no_error_and_all_of_the_contrast(scan):
    log, grid = WholeLog.random(4000, rows=4, row_pitch_mm=6.0), ImageGrid(160, 400.0)
    truth = log.truth(grid)
    whole = LogScan("4000", Projector(scan.projector.geometry, grid), scan.lines, truth, log)
    assert whole.error(truth, [0, 1, 2, 3]) == 0.0
    assert whole.error(1.1 * truth, [0, 1, 2, 3]) == pytest.approx(0.1, rel=1e-4)
    for name in ("nail", "knot"):
        share = log.inclusion_alone(name, grid)
        (density,) = (one.density for one in log.inclusions if one.name == name)
        assert whole.contrast(truth, name) == pytest.approx(1.0)
        # Half of what it adds to the wood is half of its contrast.
        assert whole.contrast(truth - 0.5 * density * share, name) == pytest.approx(0.5, abs=0.1)


# The ray to the middle of the detector, between its two middle cells, runs through the centre of rotation.
STRAIGHT = Theta(0.0, 700.0, 0.0, 0.0, 0.0)
FINE_GRID = ImageGrid(64, 400.0)


@pytest.fixture(scope="module")
def geometry():
    return FanBeamGeometry(SCANNER, STRAIGHT, np.arange(4) * TAU / 4)


@pytest.mark.parametrize("seed", [4000, 4001, 4002])
def test_each_log_is_wood_in_air_and_its_data_are_its_integrals(geometry, seed):
    log = WholeLog.random(seed, rows=1)
    truth, data = log.truth(FINE_GRID), log.sinograms(geometry, noise=0.0)
    assert truth.min() >= 0.0
    assert not truth[:, :2].any()
    assert 0.008 < truth[:, 31:33, 31:33].mean() < 0.03
    projected = Projector(geometry, FINE_GRID).forward(truth)
    # The truth's area means keep the attenuation of a whole view.
    assert data.sum(axis=-1) == pytest.approx(projected.sum(axis=-1), rel=5e-3)
    noisy = log.sinograms(geometry, noise=0.04) - data
    assert noisy.std() / np.sqrt(np.mean(data**2)) == pytest.approx(0.04, rel=0.1)
