"""Whole logs, and the table of methods on them."""

import astra
import numpy as np
import pytest
from astra_rivals import STOPS, tuned
from log_methods import METHODS
from log_scans import LogScan, whole_scan
from missing_parts import first_by_day
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


def test_astra_stops_where_the_error_is_least(scan):
    lines, truth = scan.lines[:1], scan.truth[:1]
    found = tuned("CGLS", scan.projector, lines, truth, STOPS["CGLS"])
    assert found.iterations in STOPS["CGLS"]
    at = STOPS["CGLS"].index(found.iterations)
    before, there, after = (astra_image(scan, lines[0], stop) for stop in STOPS["CGLS"][at - 1 : at + 2])
    assert np.allclose(found.images[0], np.maximum(there, 0.0), atol=1e-5)
    least = scan.error(found.images, [0])
    assert least < min(scan.error(np.maximum(image, 0.0)[None], [0]) for image in (before, after))
    assert scan.error(tuned("SIRT", scan.projector, lines, truth, STOPS["SIRT"]).images, [0]) < least


def astra_image(scan, line, iterations):
    grid, scanner = scan.projector.grid, scan.projector.geometry.scanner
    volume = astra.create_vol_geom(grid.size, grid.size, -200.0, 200.0, -200.0, 200.0)
    rays = astra.create_proj_geom("fanflat_vec", scanner.num_detector_pixels, scan.projector.geometry.astra_vectors())
    operator = astra.OpTomo(astra.create_projector("line_fanflat", rays, volume))
    return operator.reconstruct("CGLS", line, iterations=iterations)


@pytest.mark.parametrize("method", first_by_day(4, [name for name in METHODS if name != "SIRT, tuned"]))
def test_seconds_are_measured_anew_with_the_settings_that_were_chosen(method, scan):
    first = METHODS[method](scan, None)
    again = METHODS[method](scan, first.settings)
    assert again.settings == first.settings
    assert np.allclose(again.images, first.images, atol=1e-6)
    assert again.choosing_cpu_s == 0.0
    for name, value in first.settings.items():
        # A setting that is given is used: nothing is chosen in its place. The coupling of a log may be 0.
        other = METHODS[method](scan, {**first.settings, name: 0.5 * value or 0.1})
        assert not np.allclose(other.images, first.images, atol=1e-6), name


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
