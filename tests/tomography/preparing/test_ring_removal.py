import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.preparing.row_corrections import remove_rings, stripes
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.sinograms.air import median_of_views


@pytest.fixture(scope="module")
def geometry(scanner, theta, full_turn):
    return FanBeamGeometry(scanner, theta, full_turn(180))


@pytest.fixture(scope="module")
def clean(scanner, geometry):
    body = LogModel.random(41).slice_at(60.0)
    cells = DetectorCells.of(scanner)
    return analytic.project(body, cells, geometry.frame, geometry.angles_rad, rays_per_cell=2).astype(np.float32)


def test_rings_of_unequal_cells_go_and_the_log_stays(geometry, clean):
    unequal = 0.04 * np.random.default_rng(42).standard_normal(clean.shape[1]).astype(np.float32)
    striped = clean + unequal
    projector = Projector(geometry, ImageGrid(128, 400.0))
    truth, with_rings, without = (fbp(projector, s).image for s in (clean, striped, remove_rings(striped)))
    size = np.linalg.norm(truth)
    before, after = (float(np.linalg.norm(image - truth) / size) for image in (with_rings, without))
    # What is left is the log's own detail along the detector, which a median of 9 cells cannot tell from a stripe.
    assert after < 0.7 * before
    assert stripes(median_of_views(striped)) == pytest.approx(0.04, rel=0.35)
    assert stripes(median_of_views(remove_rings(striped))) < 0.002


def test_what_is_alike_in_all_cells_is_left_alone():
    ramp = np.linspace(0.0, 1.0, 40, dtype=np.float32)[:, None] + np.linspace(0.0, 2.0, 60, dtype=np.float32)
    np.testing.assert_array_equal(remove_rings(ramp), ramp)


def test_the_sinogram_given_is_not_changed(clean):
    before = clean.copy()
    remove_rings(clean)
    np.testing.assert_array_equal(clean, before)


@pytest.mark.parametrize("window", [1, 4])
def test_a_window_must_be_odd(clean, window):
    with pytest.raises(ValueError, match=f"odd number of cells from 3 on, not {window}"):
        remove_rings(clean, window)
