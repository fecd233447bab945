"""The stack of the paper from its file to slices: a board before a log, counts with ten flats, views that lost rows."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import sawmill_calibration as sawmill
from sawmill_calibration.drift_checks.drift_check import mean_of_common_rows
from sawmill_calibration.known_geometry import drawing_of, to_phantom
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_tomography.geometry.geometry import TAU, Scanner, Theta
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells

pytestmark = pytest.mark.slow

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=128, detector_pitch_mm=9.0)
THETA = Theta(0.9, 710.0, 240.0, 35.0, 0.2)
VIEWS, BOARD, ROWS, MOST_LOST = 120, 12, 40, 6
PHOTONS, DARK = 20_000.0, 100.0
ANGLES = (np.arange(VIEWS) + 0.5) * TAU / VIEWS


@dataclass(frozen=True, eq=False)
class Scans:
    """A file whose views have all rows, one whose views lost some, and the rows that each view of that one has."""

    whole: Path
    lost: Path
    there: np.ndarray
    top: np.ndarray


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Counts whose gain differs from row to row by 5 %; a third of the views is short of one to six rows, moved up."""
    frame, cells = THETA.source_frame(SCANNER.source_to_cor_mm), DetectorCells.of(SCANNER)
    board = to_phantom(drawing_of("l-shape")).moved(12.0, -8.0).of_density(SAPWOOD_PER_MM)
    log = LogModel.random(1)
    bodies = [board, *(log.slice_at(20.0 + 3.0 * row) for row in range(ROWS - BOARD))]
    rows = [analytic.project(body, cells, frame, ANGLES) for body in bodies]
    lines = np.stack([rows[0]] * BOARD + rows[1:], axis=1)
    rng = np.random.default_rng(81)
    gain = PHOTONS * (1.0 + 0.05 * rng.standard_normal((ROWS, 1)) + 0.03 * rng.standard_normal(lines.shape[1:]))
    counts = (rng.poisson(0.98 * gain * np.exp(-lines)) + DARK).astype(np.float32)
    flats = (rng.poisson(gain, (10, *gain.shape)) + DARK).astype(np.float32)
    lost, there, top = counts.copy(), np.ones((VIEWS, ROWS), bool), np.zeros(VIEWS, int)
    for view in rng.permutation(VIEWS)[: VIEWS // 3]:
        gone = rng.integers(1, MOST_LOST + 1)
        top[view] = rng.integers(0, gone + 1)
        there[view] = False
        there[view, top[view] : ROWS - gone + top[view]] = True
        lost[view] = np.nan
        lost[view, : ROWS - gone] = counts[view, there[view]]
    folder = tmp_path_factory.mktemp("stack")
    fields = {"flats": flats, "darks": np.full((1, *gain.shape), DARK, np.float32), "angles_deg": np.rad2deg(ANGLES)}
    np.savez(folder / "whole.npz", projections=counts, **fields)
    np.savez(folder / "lost.npz", projections=lost, **fields)
    return Scans(folder / "whole.npz", folder / "lost.npz", there, top)


def read(path, **options):
    pitches = {"detector_pitch_mm": 6.0, "row_pitch_mm": 3.0}
    return sawmill.read_scan(path, data="counts", source_to_cor_mm=SCANNER.source_to_cor_mm, **pitches, **options)


@pytest.fixture(scope="module")
def whole(scans):
    return read(scans.whole)


@pytest.fixture(scope="module")
def mended(scans):
    return read(scans.lost, align_rows="profile")


def test_every_row_keeps_its_number_and_its_own_views(whole, mended, scans):
    assert mended.rows == (0, ROWS)
    np.testing.assert_array_equal(~np.isnan(mended.line_integrals[:, :, 0]), scans.there)
    # Flats of a wrong row would leave 5 %; the air of a row is measured over other views than without the loss.
    assert np.abs((mended.line_integrals - whole.line_integrals)[scans.there]).max() < 0.01
    moved = f"{int((scans.top > 0).sum())} of {VIEWS} views moved by 0 to {scans.top.max()} whole rows"
    assert moved in mended.remarks[-1]


def test_the_calibration_uses_all_rows_of_the_board_and_is_as_good(whole, mended):
    # At 0.1 mm either is at the border of a pass.
    calibrations = [sawmill.calibrate(scan, "l-shape", seed=1, tolerance_mm=0.2) for scan in (whole, mended)]
    without, with_loss = calibrations
    assert (with_loss.result.rows, with_loss.result.views) == ((0, BOARD), VIEWS)
    assert with_loss.verdict == without.verdict, with_loss.result.reasons
    by_board = [found.result.log_check.phantom.cor_column_mm for found in calibrations]
    # The two share two thirds of their samples and more.
    assert abs(by_board[1] - by_board[0]) < with_loss.result.log_check.phantom_standard_deviation.cor_column_mm
    bounds = [one.predicted_ray_error_mm.upper_95 for one in (without, with_loss)]
    # Up to a third fewer samples: noise makes the bound up to 1.22 times as large.
    assert bounds[1] == pytest.approx(bounds[0], rel=0.22)


# The noise of the views that are not there: a Hann window averages it over 32 pixels, a small weight keeps it. With a
# weight, total variation does not look for one, which takes ten times as long.
@pytest.mark.parametrize(
    ("method", "apart"), [({"method": "fbp"}, 0.02), ({"method": "total_variation", "weight": 0.02}, 0.1)]
)
def test_slices_of_rows_that_views_lack_are_as_good(whole, mended, scans, method, apart):
    # The last rows: a log without the views that lost them at the bottom.
    asked = {**method, "size": 32, "field_mm": 400.0, "rows": f"{ROWS - 2}:{ROWS}"}
    without, with_loss = (sawmill.reconstruct(scan, THETA, **asked) for scan in (whole, mended))
    assert with_loss.result.rows == (ROWS - 2, ROWS)
    assert with_loss.result.fewest_views == scans.there[:, ROWS - 2 :].sum(axis=0).min() < VIEWS
    assert np.linalg.norm(with_loss.volume - without.volume) < apart * np.linalg.norm(without.volume)


def test_drift_averages_the_rows_that_all_views_have(whole, mended, scans):
    there = scans.there.all(axis=0)
    mean = mean_of_common_rows(mended.line_integrals[:, BOARD:], BOARD)
    expected = whole.line_integrals[:, BOARD:][:, there[BOARD:]].mean(axis=1)
    np.testing.assert_allclose(mean.sinogram, expected, atol=0.01)
    lacking = ", ".join(str(row) for row in range(BOARD, ROWS) if not there[row])
    assert mean.remarks == (f"rows {lacking} were left out, which some views lack",)
    with pytest.raises(JobFailure, match=f"no row from {ROWS - 1} to {ROWS - 1} is in every view"):
        mean_of_common_rows(mended.line_integrals[:, -1:], ROWS - 1)
