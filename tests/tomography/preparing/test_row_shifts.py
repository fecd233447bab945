"""Views that lost rows, by both ways: the same log, the same losses, the same demands."""

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.preparing import row_shifts
from sawmill_tomography.preparing.row_shifts import RowsError, RowShifts, shifted
from sawmill_tomography.preparing.shifts_by_features import shifts_by_features
from sawmill_tomography.preparing.shifts_by_mass import RowMoments, shifts_by_mass
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.sinograms.present_rows import present_rows

pytestmark = pytest.mark.slow

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=256, detector_pitch_mm=4.5)
THETA = Theta(0.9, 710.0, 240.0, 35.0, 0.2)
ROW_PITCH_MM = 2.0
MOST_LOST = 10
# Of a line integral: 30 000 photons behind three attenuation lengths.
NOISE = 0.025


def project(heights_mm, angles, seed=1):
    """Line integrals (views, rows, cells) of a log at heights."""
    log = LogModel.random(seed)
    geometry = FanBeamGeometry(SCANNER, THETA, angles)
    cells = DetectorCells.of(SCANNER)
    rows = [analytic.project(log.slice_at(z), cells, geometry.frame, angles, rays_per_cell=1) for z in heights_mm]
    return np.stack(rows, axis=1).astype(np.float32)


def noisy(stack, seed):
    return stack + NOISE * np.random.default_rng(seed).standard_normal(stack.shape).astype(np.float32)


def lose_rows(stack, seed):
    """Each view without some rows at the top, moved up, and at the bottom; and how many at the top."""
    rng = np.random.default_rng(seed)
    views, rows, _ = stack.shape
    top, bottom = rng.integers(0, MOST_LOST + 1, (2, views))
    lost = np.full_like(stack, np.nan)
    for view in range(views):
        kept = rows - top[view] - bottom[view]
        lost[view, :kept] = stack[view, top[view] : top[view] + kept]
    return lost, top


def moments(stack):
    return RowMoments.of(stack, np.ones(stack.shape[2], bool))


def aligned(stack, shifts):
    present = present_rows(stack)
    return np.stack([shifted(image, present[view], shifts.rows[view]) for view, image in enumerate(stack)])


def even(mass):
    return RowMoments(mass, np.zeros_like(mass))


def apart(shifts, truth):
    """Errors less their mean: the log has no row 0."""
    error = shifts.rows - truth
    return error - error.mean()


@pytest.fixture(scope="module")
def sparse():
    """60 views round the turn, and their angles."""
    angles = (np.arange(60) + 0.5) * TAU / 60
    return project(20.0 + ROW_PITCH_MM * np.arange(100), angles), angles


@pytest.fixture(scope="module")
def dense():
    """20 views two degrees apart, and their angles."""
    angles = (np.arange(20) + 0.5) * TAU / 180
    return project(20.0 + ROW_PITCH_MM * np.arange(100), angles), angles


class TestByMass:
    @pytest.mark.parametrize("seed", [11, 12, 13])
    def test_whole_lost_rows_are_found_exactly(self, sparse, seed):
        stack, angles = sparse
        lost, truth = lose_rows(noisy(stack, seed), seed)
        shifts = shifts_by_mass(moments(lost), angles)
        assert shifts.whole
        np.testing.assert_array_equal(shifts.rows, truth - truth.min())
        # Its standard deviation before rounding to whole rows.
        assert 0.01 < np.median(shifts.standard_deviation) < 0.1

    def test_rows_that_stay_where_they_are_and_miss_at_both_ends(self, sparse):
        stack = noisy(sparse[0], 14)
        lost, _ = lose_rows(stack, 14)
        in_place = np.where(np.isnan(np.roll(lost, 3, axis=1)), np.nan, stack)
        assert not shifts_by_mass(moments(in_place), sparse[1]).rows.any()

    def test_fractions_of_a_row_are_found_to_a_tenth(self):
        rng = np.random.default_rng(15)
        views = 12
        angles, truth = (np.arange(views) + 0.5) * TAU / views, rng.uniform(0.0, 6.0, views)
        heights = 20.0 + ROW_PITCH_MM * np.arange(70)
        stack = np.concatenate(
            [project(heights + ROW_PITCH_MM * truth[view], angles[view : view + 1]) for view in range(views)]
        )
        shifts = shifts_by_mass(moments(noisy(stack, 16)), angles)
        assert not shifts.whole
        error = apart(shifts, truth)
        assert np.sqrt(np.mean(error**2)) < 0.1
        assert np.abs(error).max() < 0.25

    @pytest.mark.parametrize("board", [0, 12])
    @pytest.mark.parametrize("fractions", [False, True])
    def test_the_standard_deviations_hold(self, sparse, board, fractions):
        # A board before the log, of half its mass, ends between two rows; a third of the views moved along the log by
        # parts of a row, which mix two of them as a detector's row does.
        stack = noisy(sparse[0], 41)
        stack[:, :board] = noisy(0.5 * sparse[0][:, 50:51].repeat(board, axis=1), 42)
        rng = np.random.default_rng(43)
        lost, truth = np.full_like(stack, np.nan), np.zeros(60)
        for view in range(60):
            part = rng.uniform(0.2, 0.8) if fractions and view % 3 == 0 else 0.0
            top = int(rng.integers(1, 7)) if view % 3 == 1 else 0
            between = (1.0 - part) * stack[view, :-1] + part * stack[view, 1:]
            lost[view, : between.shape[0] - top], truth[view] = between[top:], top + part
        found = shifts_by_mass(moments(lost), sparse[1])
        assert found.whole is not fractions
        # Those that did not move by parts are not resampled.
        np.testing.assert_array_equal(found.rows[truth == 0.0], 0.0)
        np.testing.assert_array_equal(found.rows[1::3], truth[1::3])
        assert np.sqrt(np.mean(((found.rows - truth) / found.standard_deviation) ** 2)) < 1.5
        if fractions:
            assert np.abs(found.rows - truth).max() < 0.25
            assert 0.02 < np.median(found.standard_deviation[::3]) < 0.15

    def test_the_slices_are_as_good_as_without_the_loss(self, sparse):
        clean, angles = sparse
        stack = noisy(clean, 17)
        lost, truth = lose_rows(stack, 17)
        mended = aligned(lost, shifts_by_mass(moments(lost), angles))
        # In the middle of a whorl of knots; not mended, the row there is off by five on the average.
        same = 12 + int(truth.max())
        projector = Projector(FanBeamGeometry(SCANNER, THETA, angles), ImageGrid(96, 400.0))
        best = fbp(projector, clean[:, same]).image

        def relative_error(sinogram):
            return float(np.linalg.norm(fbp(projector, sinogram).image - best) / np.linalg.norm(best))

        whole, unmended = relative_error(stack[:, same]), relative_error(lost[:, same - MOST_LOST // 2])
        assert relative_error(mended[:, same]) == pytest.approx(whole, rel=1e-6)
        assert unmended > 1.5 * whole

    def test_a_knot_that_comes_near_the_source_does_not_move_along_the_log(self):
        # Two lumps at two heights on opposite sides, so that their common centre swings by a tenth of their distance.
        views, rows = 40, np.arange(60.0)
        angles, truth = np.arange(views) * TAU / views, np.random.default_rng(20).uniform(0.0, 3.0, views)
        lumps = [np.exp(-0.5 * ((rows + truth[:, None] - height) / 5.0) ** 2) for height in (26.0, 36.0)]
        near, across = 0.1 * np.cos(angles)[:, None], np.sin(angles)[:, None]
        mass = 500.0 + 60.0 * ((1.0 + near) * lumps[0] + (1.0 - near) * lumps[1])
        unmended = apart(shifts_by_mass(even(mass), angles), truth)
        mended = apart(shifts_by_mass(RowMoments(mass, 60.0 * 25.0 * across * (lumps[0] - lumps[1])), angles), truth)
        assert unmended.std() > 0.2
        assert mended.std() < 0.02

    @pytest.mark.parametrize("profile", ["even", "taper"])
    def test_a_log_without_features_along_it_is_refused(self, profile):
        rng = np.random.default_rng(18)
        mass = np.full(100, 500.0) - (np.arange(100) if profile == "taper" else 0.0)
        with pytest.raises(RowsError, match=r"[Tt]he log varies too little"):
            shifts_by_mass(even(mass + 0.4 * rng.standard_normal((40, 100))), np.arange(40) * TAU / 40)

    def test_too_few_rows_are_refused(self):
        with pytest.raises(RowsError, match="view 0 has 12 rows and at least 16 are needed"):
            shifts_by_mass(even(np.random.default_rng(19).standard_normal((5, 12))), np.arange(5.0))


class TestByFeatures:
    def test_whole_lost_rows_are_found_exactly_in_dense_views(self, dense):
        stack, angles = dense
        lost, truth = lose_rows(noisy(stack, 21), 21)
        shifts = shifts_by_features(lost, angles)
        assert shifts.whole
        np.testing.assert_array_equal(shifts.rows, truth - truth.min())

    def test_a_board_before_the_log_does_not_mislead(self, dense):
        stack, angles = dense
        stack = noisy(stack, 24)
        # The same in all its rows, and half as dense again as any knot makes a row.
        stack[:, :12] = noisy(1.5 * dense[0][:, 50:51].repeat(12, axis=1), 25)
        lost, truth = lose_rows(stack, 26)
        shifts = shifts_by_features(lost, angles)
        assert shifts.whole
        np.testing.assert_array_equal(shifts.rows, truth - truth.min())

    def test_views_too_far_apart_share_nothing_and_are_refused(self, dense):
        lost, _ = lose_rows(dense[0][:16], 22)
        with pytest.raises(RowsError, match=r"no two views share enough features .* align the rows by their profile"):
            shifts_by_features(lost, np.arange(16) * TAU / 16)

    def test_a_view_alone_is_named(self, dense):
        stack, angles = dense
        lost, _ = lose_rows(stack, 23)
        lost[7] = np.where(np.isnan(lost[7]), np.nan, 0.0)
        with pytest.raises(RowsError, match="view 7 shares too few features with its neighbours"):
            shifts_by_features(lost, angles)

    def test_an_uncertain_match_blames_the_views_and_not_the_log(self, dense, monkeypatch):
        # No shift is that certain.
        monkeypatch.setattr(row_shifts, "MOST_UNCERTAIN", 1e-6)
        with pytest.raises(RowsError, match=r"is uncertain by .* too noisy for features: align the rows by their prof"):
            shifts_by_features(*dense)

    def test_too_few_rows_are_refused(self, dense):
        stack, angles = dense
        with pytest.raises(RowsError, match="view 0 has 20 rows; features need at least 32"):
            shifts_by_features(stack[:, :20], angles)

    def test_too_few_cells_are_refused(self, dense):
        stack, angles = dense
        for cells in (1, 11):
            with pytest.raises(RowsError, match=f"view 0 has {cells} detector cells; features need at least 12"):
                shifts_by_features(stack[:, :, :cells], angles)
        with pytest.raises(RowsError, match="features"):
            shifts_by_features(stack[:, :, :12], angles)


class TestAligned:
    def test_whole_rows_keep_their_numbers_and_are_not_resampled(self, sparse):
        lost, truth = lose_rows(sparse[0], 31)
        mended = aligned(lost, RowShifts.of(truth.astype(np.float64), np.zeros(60), present_rows(lost)))
        there = present_rows(mended)
        np.testing.assert_array_equal(there.sum(axis=1), present_rows(lost).sum(axis=1))
        np.testing.assert_array_equal(mended[there], sparse[0][there])

    def test_most_views_that_have_all_rows_say_where_row_0_is(self):
        present = np.ones((9, 30), bool)
        present[6:, 26:] = False
        # Two views that moved, and three that lost up to four rows at the top: none changes the numbers of the rest.
        truth = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 3.0, 1.0, 4.0, 2.0])
        shifts = RowShifts.of(truth + 7.2, np.zeros(9), present)
        assert shifts.whole
        np.testing.assert_array_equal(shifts.rows, truth)
        assert not shifts.lost(present)
        still = present[[0, 1, 2, 3, 6, 7, 8]]
        assert RowShifts.of(truth[[0, 1, 2, 3, 6, 7, 8]], np.zeros(7), still).lost(still)

    def test_where_some_moved_by_fractions_the_others_stay_as_they_are(self):
        truth = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 1.6, 2.0])
        error = np.array([0.04, -0.05, 0.0, 0.06, 0.0, 0.0, -0.04])
        shifts = RowShifts.of(truth + error + 0.3, np.full(7, 0.04), np.ones((7, 20), bool))
        assert not shifts.whole
        np.testing.assert_array_equal(shifts.rows[[0, 1, 2, 3, 6]], truth[[0, 1, 2, 3, 6]])
        np.testing.assert_allclose(shifts.rows, truth, atol=0.05)

    def test_a_row_that_shows_the_end_of_a_board_and_the_log_behind_it_shows_neither(self):
        image = np.full((20, 1), 5.0, np.float32)
        image[8:] = np.sin(0.3 * np.arange(8, 20))[:, None]
        # The detector's rows half a row further on: row 7 is half of the board.
        between = np.append(0.5 * (image[:-1] + image[1:]), image[-1:], axis=0)
        mended = shifted(between, np.ones(20, bool), 0.5, np.array([7]))[:, 0]
        assert np.flatnonzero(np.isnan(mended)).tolist() == [0, 7, 8]
        np.testing.assert_array_equal(mended[1:7], 5.0)
        # Linear interpolation there and back costs 0.3 squared over 8 of a wave; its ends repeat the last row.
        np.testing.assert_allclose(mended[10:-1], image[10:-1, 0], atol=0.02)

    def test_fractions_are_resampled_to_what_stands_between(self):
        rows = np.arange(40.0)
        shift = np.array([0.0, 0.5, 0.27, 1.6])
        wave = np.sin(0.3 * (rows + shift[:, None]))[..., None].astype(np.float32)
        shifts = RowShifts.of(shift, np.zeros(4), present_rows(wave))
        assert not shifts.whole
        mended = aligned(wave, shifts)
        common = np.flatnonzero(present_rows(mended).all(axis=0))
        expected = np.sin(0.3 * common)
        # Cubic convolution of a wave of 21 rows: third-order error, and ends that repeat the last row.
        np.testing.assert_allclose(mended[:, common[1:-1], 0], np.tile(expected[1:-1], (4, 1)), atol=2e-3)
        np.testing.assert_array_equal(np.isnan(mended[1, :, 0]), rows < 0.5)
