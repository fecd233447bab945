"""Rows of line integrals after their corrections: air, faulty cells, rings."""

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.preparing.row_corrections import Corrections, RowCorrector, remove_rings, stripes
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.sinograms.air import median_of_views
from sawmill_vocabulary import AirCorrection
from sawmill_vocabulary.messages import selected
from sawmill_vocabulary.reading_messages import PreparingMessage

VIEWS, ROWS = 60, 3
NOISE = 0.005


@pytest.fixture(scope="module")
def clean(scanner, theta, full_turn):
    geometry = FanBeamGeometry(scanner, theta, full_turn(VIEWS))
    log, cells = LogModel.random(51), DetectorCells.of(scanner)
    slices = [log.slice_at(60.0 + 2.0 * row) for row in range(ROWS)]
    rows = [analytic.project(slice_, cells, geometry.frame, geometry.angles_rad) for slice_ in slices]
    return np.stack(rows, axis=1).astype(np.float32)


def corrected_rows(stack, corrections):
    corrector = RowCorrector(corrections, *stack.shape[1:])
    corrector.correct(stack)
    return corrector.result()


def noisy(clean, seed):
    return clean + NOISE * np.random.default_rng(seed).standard_normal(clean.shape).astype(np.float32)


def test_a_drifting_source_and_faulty_cells_are_corrected_and_reported(clean):
    stack = noisy(clean, 53) + 0.02 * np.random.default_rng(52).standard_normal((VIEWS, ROWS, 1)).astype(np.float32)
    stack[:, 1, 300] = 9.0
    stack[:, 2, 500:502] = 13.8
    done = corrected_rows(stack, Corrections(AirCorrection.VIEWS))
    assert np.argwhere(done.faulty).tolist() == [[1, 300], [2, 500], [2, 501]]
    error = stack - clean
    # Cells that were bridged see the log's detail, not its noise.
    assert error[~np.broadcast_to(done.faulty, error.shape)].std() == pytest.approx(NOISE, rel=0.02)
    assert np.abs(error[:, 1, 300]).max() < 0.3
    assert done.remarks[0] == PreparingMessage.FAULTY_CELLS(cells=3, rows=2)
    assert done.remarks[1].message is PreparingMessage.AIR_LEVEL
    assert done.remarks[1].values["cells"] > 200
    assert done.remarks[2].startswith("In 3 rows it was taken out view by view, where it varied by 0.0")


def test_rows_are_corrected_one_by_one_as_in_the_whole_stack(clean):
    stack = noisy(clean, 54) + np.float32(0.03)
    stack[:, 2, 300] = 9.0
    apart = stack.copy()
    corrections = Corrections(AirCorrection.VIEWS, remove_rings=True)
    done = corrected_rows(stack, corrections)
    corrector = RowCorrector(corrections, *stack.shape[1:])
    for row in range(ROWS):
        corrector.correct(apart[:, row : row + 1], row)
    np.testing.assert_array_equal(apart, stack)
    np.testing.assert_array_equal(corrector.result().faulty, done.faulty)
    assert corrector.result().remarks == done.remarks


def test_missing_rows_stay_missing_and_a_level_that_cannot_be_air_is_kept_and_reported(clean):
    stack = noisy(clean, 55) + np.float32(0.05)
    stack[7, 0] = np.nan
    done = corrected_rows(stack, Corrections(AirCorrection.BACKGROUND))
    assert np.isnan(stack[7, 0]).all()
    assert np.isfinite(np.delete(stack, 7, axis=0)).all()
    assert abs(float(np.nanmean(stack - clean))) < 0.001
    assert "taken out of 3 rows: 0.050 in the mean" in done.remarks[0]
    stack = noisy(clean, 56) + np.float32(0.8)
    before = stack.copy()
    done = corrected_rows(stack, Corrections(AirCorrection.VIEWS, largest_air_level=0.3))
    np.testing.assert_array_equal(stack, before)
    assert done.remarks == (PreparingMessage.ROWS_WITHOUT_AIR(rows=3),)


def test_rings_are_left_unless_asked_and_reported_where_they_show(clean):
    unequal = 0.05 * np.random.default_rng(57).standard_normal(clean.shape[1:]).astype(np.float32)
    stack = noisy(clean, 58) + unequal
    remarks = corrected_rows(stack, Corrections(AirCorrection.OFF)).remarks
    assert len(remarks) == 1
    assert remarks[0].message is PreparingMessage.RINGS_VISIBLE
    done = corrected_rows(stack, Corrections(AirCorrection.OFF, remove_rings=True))
    (remark,) = selected(done.remarks, PreparingMessage.RINGS_REMOVED)
    assert remark.values["window"] == 9
    assert (stack - clean).std() < 0.6 * (unequal.std() + NOISE)


def test_a_sound_steady_row_is_hardly_touched(clean):
    stack = noisy(clean, 59)
    before = stack.copy()
    done = corrected_rows(stack, Corrections(AirCorrection.VIEWS))
    assert not done.faulty.any()
    # One constant a row, the mean of some 20 000 samples.
    assert np.abs(stack - before).max() < 5.0 * NOISE / 100.0
    assert len(done.remarks) == 1


@pytest.fixture(scope="module")
def many_views(scanner, theta, full_turn):
    return FanBeamGeometry(scanner, theta, full_turn(180))


@pytest.fixture(scope="module")
def sinogram_of_a_log(scanner, many_views):
    body = LogModel.random(41).slice_at(60.0)
    cells = DetectorCells.of(scanner)
    return analytic.project(body, cells, many_views.frame, many_views.angles_rad).astype(np.float32)


def test_rings_of_unequal_cells_go_and_the_log_stays(many_views, sinogram_of_a_log):
    unequal = 0.04 * np.random.default_rng(42).standard_normal(sinogram_of_a_log.shape[1]).astype(np.float32)
    striped = sinogram_of_a_log + unequal
    projector = Projector(many_views, ImageGrid(128, 400.0))
    truth, with_rings, without = (fbp(projector, s).image for s in (sinogram_of_a_log, striped, remove_rings(striped)))
    np.testing.assert_array_equal(striped, sinogram_of_a_log + unequal)
    size = np.linalg.norm(truth)
    before, after = (float(np.linalg.norm(image - truth) / size) for image in (with_rings, without))
    # What is left are the log's own growth rings, which a median of 9 cells cannot tell from stripes.
    assert after < 0.75 * before
    assert stripes(median_of_views(striped)) == pytest.approx(0.04, rel=0.35)
    assert stripes(median_of_views(remove_rings(striped))) < 0.002


def test_what_is_alike_in_all_cells_is_left_alone():
    ramp = np.linspace(0.0, 1.0, 40, dtype=np.float32)[:, None] + np.linspace(0.0, 2.0, 60, dtype=np.float32)
    np.testing.assert_array_equal(remove_rings(ramp), ramp)
