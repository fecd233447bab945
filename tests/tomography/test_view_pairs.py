"""Drift from few views: what any two of them have in common, and, of a beam that hardens, opposite rays beside it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mill_scans import line_integrals

from sawmill_tomography.drift.change import ConjugateFit, DriftError, drift_change
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.drift.view_pairs.view_pairs import view_pair_fit
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, GeometryError, Scanner, SourceFrame, Theta
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_tomography.projection.simulate import simulate_stack
from sawmill_tomography.sinograms.present_rows import bridge_masked
from sawmill_vocabulary import Rotation

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
THETA = Theta(0.7, 715.0, 180.0, 30.0, 0.15)


# No waves around a log's outlines.
CIRCLES = ((0j,) * 5,) * 5


def turn(views):
    return np.arange(views) * TAU / views


def averaged(angles, *, theta=THETA, seed=1, rows=4, moved_mm=0.0, circles=False):
    """The rays of several rows of a log off centre, averaged, and the geometry."""
    rng = np.random.default_rng(seed)
    log = LogModel.random(seed, radius_mm=rng.uniform(90, 140))
    log = replace(log, waves=CIRCLES) if circles else log
    off_mm = rng.uniform(-14, 14, 2) + moved_mm
    fan = FanBeamGeometry(MILL, theta, angles)
    slices = [log.slice_at(height).moved(*off_mm) for height in rng.uniform(30, 370, rows)]
    return np.mean([project(each, DetectorCells.of(MILL), fan.frame, angles) for each in slices], axis=0), fan.frame


def noisy(rays, rng, *, rows, noise=0.02, slope=0.0, gain=0.0):
    """Rows averaged: noise, each view's level and gain, and a flat field that slopes and bends over the detector."""
    across = np.linspace(-1.0, 1.0, rays.shape[1])
    bent = slope * (rng.standard_normal(3) / [1.0, 3.0, 3.0]) @ [across, across**2, across**3]
    level, gains = (size * rng.standard_normal((len(rays), 1)) for size in (0.02, gain))
    scatter = noise * np.sqrt(np.mean(rays**2) / rows) * rng.standard_normal(rays.shape)
    return rays * (1.0 + gains) + scatter + level + bent


def error_of(fit, frame):
    return np.array([fit.cor_column_mm - frame.cor_column_mm, fit.tilt_rad - frame.tilt_rad])


@pytest.mark.parametrize("angles", [turn(20), np.array([0.0, 0.3, 0.5, 1.1, 1.2, 2.0, 2.6, 3.0, 3.1])])
def test_the_sums_of_any_two_views_agree(angles):
    rays, frame = averaged(angles)
    fit = view_pair_fit(MILL, rays, angles, frame, Rotation.AS_GIVEN)
    # Of the edges of a log, cells of finite width leave this much.
    assert fit.relative_residual < 1e-5
    assert np.all(np.abs(error_of(fit, frame)) < [5e-3, 2e-4])


@pytest.mark.parametrize(
    ("views", "rows", "hardened", "gain", "worst_mm"),
    [(8, 2500, 0.0, 0.0, 0.03), (12, 60, 0.05, 0.02, 0.1), (20, 60, 0.05, 0.005, 0.05)],
)
def test_intervals_hold_and_are_narrow(views, rows, hardened, gain, worst_mm):
    """Logs and scanners at random, 2 % noise a row, flat fields that slope by 3 %, gains that scatter."""
    shares, errors = [], []
    for seed in range(16):
        rng = np.random.default_rng(1000 * views + seed)
        rays, frame = averaged(
            turn(views), theta=Theta(*rng.uniform([0, 600, -200, -60, -0.3], [6.28, 850, 200, 60, 0.3])), seed=seed
        )
        start = replace(frame, cor_column_mm=frame.cor_column_mm + 1.0, tilt_rad=frame.tilt_rad - 0.003)
        scan = noisy(rays * (1.0 - hardened * rays / rays.max()), rng, rows=rows, slope=0.03, gain=gain)
        fit = view_pair_fit(MILL, scan, turn(views), start, Rotation.AS_GIVEN)
        errors.append(error_of(fit, frame))
        shares.append(errors[-1] / fit.deviation[:2])
    assert math.sqrt(np.mean(np.square(errors), axis=0)[0]) < worst_mm
    # The RMS of 16 standard normal numbers is below 1.5 in 99.7 % of draws; Student's t widens those of 8 views.
    assert np.all(np.sqrt(np.mean(np.square(shares), axis=0)) < 1.5)
    assert np.all(np.sqrt(np.mean(np.square(shares), axis=0)) > 0.4)


@pytest.mark.parametrize("angles", [turn(10) * 0.7, turn(20)])
def test_a_beam_that_hardens_moves_nothing(angles):
    """By 5 %: over part of a turn that moved u_c by 0.07 mm."""
    # A log that is not round hardens otherwise from side to side: the bound counts what the fit of hardening leaves.
    # Of 20 logs the largest error was 1.0 and 1.2 standard deviations.
    rays, frame = averaged(angles, rows=2)
    hard = rays * (1.0 - 0.05 * rays / rays.max())
    start = replace(frame, cor_column_mm=frame.cor_column_mm + 1.0)
    fit = view_pair_fit(MILL, noisy(hard, np.random.default_rng(1), rows=10**6), angles, start, Rotation.AS_GIVEN)
    assert abs(error_of(fit, frame)[0]) < 0.01
    assert fit.deviation[0] < 0.04


def test_an_eccentric_encoder_stays_within_its_bound():
    """0.1 degrees once a turn and a log off centre moved u_c by up to 0.06 mm: the pairs show it, and it is fitted."""
    angles, shares = turn(20), []
    for seed in range(4):
        sound, frame = averaged(angles, seed=seed, rows=1)
        shifted, _ = averaged(angles + math.radians(0.1) * np.cos(angles + seed), seed=seed, rows=1)
        scans = (noisy(rays, np.random.default_rng(seed), rows=1000, gain=0.005) for rays in (sound, shifted))
        usual, fit = (view_pair_fit(MILL, scan, angles, frame, Rotation.AS_GIVEN) for scan in scans)
        assert fit.encoder_bound_mm < 0.015
        # Those of one standard deviation come from the bends, which the rays give anew.
        assert abs(fit.cor_column_mm - usual.cor_column_mm) < fit.encoder_bound_mm + 1.2 * usual.deviation[0] < 0.025
        shares.append(error_of(fit, frame) / fit.deviation[:2])
    # The RMS of 4 standard normal numbers is below 2 in 99.7 % of draws.
    assert np.all(np.sqrt(np.mean(np.square(shares), axis=0)) < 2.0)


def test_intervals_of_very_many_views_hold():
    """Part of a turn, which opposite rays cannot use: of all its views some are compared, each often enough."""
    angles = np.linspace(0.0, math.radians(220.0), 240)
    shares = []
    for seed in range(4):
        rays, frame = averaged(angles, seed=seed, rows=2)
        scan = noisy(rays, np.random.default_rng(seed), rows=2500, slope=0.03, gain=0.005)
        fit = detector_fit(MILL, scan, angles, frame, Rotation.AS_GIVEN)
        assert "45 of 240 views were compared, spread evenly over them" in fit.adjustments
        shares.append(error_of(fit, frame) / fit.deviation[:2])
    # The RMS of 4 standard normal numbers is below 2 in 99.7 % of draws.
    assert np.all(np.sqrt(np.mean(np.square(shares), axis=0)) < 2.0)


def test_known_deviations_weigh_the_rays():
    """Every other view scatters five times more behind the log: who knows that places the centre closer."""
    rays, frame = averaged(turn(20))
    deviations = np.where((rays > 0.1) & (np.arange(20)[:, None] % 2 == 0), 0.025, 0.005)
    shares, closer = [], []
    for seed in range(8):
        scan = rays + deviations * np.random.default_rng(seed).standard_normal(rays.shape)
        plain, fit = (
            detector_fit(MILL, scan, turn(20), frame, Rotation.AS_GIVEN, deviations=known)
            for known in (None, deviations)
        )
        shares.append(error_of(fit, frame) / fit.deviation[:2])
        closer.append(plain.deviation[0] / fit.deviation[0])
    # Bounds of the RMS of 8 standard normal numbers, 99.9 % on either side.
    assert np.all((np.array([0.35]) < (rms := np.sqrt(np.mean(np.square(shares), axis=0)))) & (rms < 1.75))
    assert min(closer) > 1.4


@pytest.mark.parametrize(
    ("deviations", "sentence"),
    [
        (np.ones((20, 767)), r"have shape \(20, 767\), but the line integrals \(20, 768\)"),
        (np.full((20, 768), -0.1), "must be positive and finite, or 0 where none is known"),
    ],
)
def test_deviations_that_cannot_be_are_refused(deviations, sentence):
    rays, frame = averaged(turn(20), rows=1)
    with pytest.raises(GeometryError, match=sentence):
        detector_fit(MILL, rays, turn(20), frame, Rotation.AS_GIVEN, deviations=deviations)


def test_a_mill_s_counts_show_a_turntable_that_moved_by_half_a_millimetre():
    theta = replace(THETA, source_shift_mm=179.5, detector_shift_mm=30.5)
    truth, calibrated = (each.source_frame(MILL.source_to_cor_mm) for each in (theta, THETA))
    slices = [LogModel.random(4).slice_at(60.0 + 25.0 * row).moved(5.0, -3.0) for row in range(6)]
    scan = simulate_stack(slices, FanBeamGeometry(MILL, theta, turn(20)), photons=20_000.0, seed=4)
    rays = line_integrals(scan.counts, scan.flats, scan.darks).stack.mean(axis=1)
    changed = drift_change(MILL, calibrated, None, view_pair_fit(MILL, rays, turn(20), calibrated, Rotation.AS_GIVEN))
    expected = truth.cor_column_mm - calibrated.cor_column_mm
    assert abs(changed.change[0] - expected) < min(0.3, 3.0 * changed.deviation[0])
    assert changed.ray_change_mm > 3.0 * changed.ray_change_uncertainty_mm


@pytest.mark.parametrize("first", range(3))
@pytest.mark.parametrize("views", [8, 20, 45])
def test_one_row_of_the_published_log_shows_its_centre(scanner, theta, full_turn, log_sinogram, views, first):
    truth = theta.source_frame(scanner.source_to_cor_mm)
    taken = slice(first, None, 360 // views)
    start = replace(truth, cor_column_mm=truth.cor_column_mm + 2.0)
    fit = view_pair_fit(scanner, log_sinogram[taken], full_turn(360)[taken], start, Rotation.AS_GIVEN)
    assert abs(error_of(fit, truth)[0]) < min(0.3, 3.0 * fit.deviation[0])
    assert fit.rotation_decided


@pytest.mark.parametrize("sense", list(Rotation))
def test_the_other_sense_of_rotation_is_seen(sense):
    rays, frame = averaged(turn(20))
    scan = noisy(rays, np.random.default_rng(3), rows=100)
    fit = view_pair_fit(MILL, scan, sense.apply(turn(20)), frame, Rotation.AS_GIVEN)
    assert (fit.rotation, fit.rotation_decided) == (sense, True)
    assert abs(error_of(fit, frame)[0]) < 0.1


def test_faulty_cells_and_corrupt_views_are_left_out():
    rays, frame = averaged(turn(20))
    scan = noisy(rays, np.random.default_rng(3), rows=100)
    scan[:, 400], scan[7] = 0.0, 30.0
    fit = view_pair_fit(MILL, scan, turn(20), frame, Rotation.AS_GIVEN)
    left_out = [words.split(" were")[0] for words in fit.adjustments]
    assert left_out == ["1 detector cells without a usable signal", "1 corrupt views"]
    assert abs(error_of(fit, frame)[0]) < min(0.2, 4.0 * fit.deviation[0])


@pytest.mark.parametrize(("cells", "value"), [([0], 0.0), ([766, 767], 8.0)])
def test_dead_cells_at_an_end_are_no_log_that_is_cut_off(cells, value):
    rays, frame = averaged(turn(20))
    scan = noisy(rays, np.random.default_rng(3), rows=100)
    sound = view_pair_fit(MILL, scan, turn(20), frame, Rotation.AS_GIVEN)
    scan[:, cells] = value
    fit = view_pair_fit(MILL, scan, turn(20), frame, Rotation.AS_GIVEN)
    assert fit.adjustments == (f"{len(cells)} detector cells without a usable signal were left out.",)
    # They are air, of which hundreds of cells are left.
    assert fit.cor_column_mm == pytest.approx(sound.cor_column_mm, abs=0.3 * sound.deviation[0])


def test_the_noise_of_the_flat_fields_counts():
    """A pattern of the cells as large as the noise, in every view alike: 20 views average the noise and not it."""
    shares, plain = [], []
    for seed in range(20):
        (rays, frame), rng = averaged(turn(20), seed=seed), np.random.default_rng(seed)
        scan = rays + 0.003 * rng.standard_normal(rays.shape)
        plain.append(view_pair_fit(MILL, scan, turn(20), frame, Rotation.AS_GIVEN).deviation[0])
        fit = view_pair_fit(MILL, scan + 0.003 * rng.standard_normal(768), turn(20), frame, Rotation.AS_GIVEN)
        shares.append(error_of(fit, frame) / fit.deviation[:2])
        assert fit.deviation[0] > 1.35 * plain[-1]
    # The RMS of 20 standard normal numbers is between 0.5 and 1.5 in 99.8 % of draws.
    assert np.all(np.abs(np.sqrt(np.mean(np.square(shares), axis=0)) - 1.0) < 0.5)


def test_smooth_structure_of_the_flat_field_counts_as_the_air_shows_it():
    """Bumps 40 cells wide of 0.1 % in every view alike moved u_c by 7 standard deviations; none widen none."""
    rays, frame = averaged(turn(20), rows=2)
    bump = np.hanning(81) / np.linalg.norm(np.hanning(81))
    sound, bumpy, wider = [], [], []
    for seed in range(7):
        rng = np.random.default_rng(seed)
        scan = rays + 0.002 * rng.standard_normal(rays.shape)
        structure = 0.001 * np.convolve(rng.standard_normal(768), bump, "same")
        plain, fit = (
            view_pair_fit(MILL, each, turn(20), frame, Rotation.AS_GIVEN) for each in (scan, scan + structure)
        )
        sound.append(error_of(plain, frame) / plain.deviation[:2])
        bumpy.append(error_of(fit, frame) / fit.deviation[:2])
        wider.append(fit.deviation[0] / plain.deviation[0])
    # The RMS of 7 standard normal numbers is between 0.29 and 1.87 in 99.8 % of draws.
    for shares in (sound, bumpy):
        assert np.all(np.abs(np.sqrt(np.mean(np.square(shares), axis=0)) - 1.08) < 0.79)
    assert np.median(wider) > 2.0


@pytest.mark.parametrize("known", [False, True])
def test_wide_masks_are_bridged_by_what_other_views_show_there(known):
    """A shadow of 30 cells goes round with a nail near the bark: lines across it refused the log as one that moved."""
    rays, frame = averaged(turn(20))
    at = (384 + 115 * np.sin(turn(20))).astype(int)[:, None] + np.arange(30)
    masked = np.zeros(rays.shape, bool)
    np.put_along_axis(masked, at, True, axis=1)
    for seed in range(4):
        scan = rays + 0.002 * np.random.default_rng(seed).standard_normal(rays.shape)
        missed = bridge_masked(scan, masked)
        deviations = np.where(masked, missed, 0.002) if known else missed
        fit = view_pair_fit(MILL, scan, turn(20), frame, Rotation.AS_GIVEN, deviations=deviations)
        # Of four draws from a normal distribution 99.6 % are all within 3.3 standard deviations.
        assert np.all(np.abs(error_of(fit, frame)) < 3.3 * fit.deviation[:2])
        assert fit.deviation[0] < 0.1


def test_a_bridge_is_as_wrong_as_its_deviation_says():
    """Sums over bridges of ellipses' shadows, at the limb and behind the middle."""
    rays, _ = averaged(turn(20))
    rays += 0.002 * np.random.default_rng(1).standard_normal(rays.shape)
    shares = []
    for view in range(20):
        for first in (310, 384, 450):
            masked, scan = np.zeros(rays.shape, bool), rays.copy()
            masked[view, first : first + 24], scan[view, first : first + 24] = True, np.nan
            deviations = bridge_masked(scan, masked)
            assert not deviations[~masked].any()
            shares.append((scan - rays)[masked].sum() / (math.sqrt(24.0) * deviations[view, first]))
    # Of 60 standard normal numbers the RMS is within 0.3 of 1 in 99.8 % of draws; these are not quite independent.
    assert np.sqrt(np.mean(np.square(shares))) == pytest.approx(1.0, abs=0.4)


def test_a_flat_field_that_slopes_does_not_move_a_dense_scan():
    """By 3 %, with gains of 0.5 %: what the views' gains made of the slope moved u_c by 0.01 mm."""
    rays, frame = averaged(turn(120), rows=1)
    scan = rays * (1.0 + 0.005 * np.random.default_rng(1).standard_normal((120, 1)))
    sloped = scan + 0.03 * np.linspace(-0.5, 0.5, 768)
    flat, fit = (detector_fit(MILL, each, turn(120), frame, Rotation.AS_GIVEN) for each in (scan, sloped))
    assert fit.cor_column_mm == pytest.approx(flat.cor_column_mm, abs=1e-4)


def test_dense_scans_all_round_keep_their_opposite_rays(scanner, theta, full_turn, log_sinogram):
    start = theta.source_frame(scanner.source_to_cor_mm)
    dense = detector_fit(scanner, log_sinogram, full_turn(360), start, Rotation.AS_GIVEN)
    part = detector_fit(scanner, log_sinogram[:220:4], full_turn(360)[:220:4], start, Rotation.AS_GIVEN)
    assert (isinstance(dense, ConjugateFit), isinstance(part, ConjugateFit)) == (True, False)
    assert abs(error_of(part, start)[0]) < 3.0 * part.deviation[0]


@pytest.mark.parametrize(
    ("circles", "sentence"),
    [(True, r"as those of a log that moved by 1\.[345]\d? mm"), (False, r"the views differ 2\d times more than noise")],
)
def test_a_log_that_moved_in_its_scan_is_no_drift(circles, sentence):
    """The sums of any two views hardly show it of round logs: opposite rays do."""
    rays, frame = averaged(turn(20), rows=2, circles=circles)
    later, _ = averaged(turn(20), rows=2, moved_mm=1.0, circles=circles)
    scan = noisy(np.concatenate([rays[:9], later[9:]]), np.random.default_rng(1), rows=100)
    with pytest.raises(DriftError, match=sentence) as refusal:
        detector_fit(MILL, scan, turn(20), frame, Rotation.AS_GIVEN)
    assert refusal.value.code == "moved-too-far"


def test_a_far_calibration_makes_nothing_less_certain():
    rays, frame = averaged(turn(20), rows=1)
    scan = noisy(rays, np.random.default_rng(1), rows=2500)
    starts = [replace(frame, cor_column_mm=frame.cor_column_mm + away) for away in (0.0, 20.0)]
    near, far = (view_pair_fit(MILL, scan, turn(20), start, Rotation.AS_GIVEN) for start in starts)
    assert far.cor_column_mm == pytest.approx(near.cor_column_mm, abs=0.5 * near.deviation[0])
    assert far.deviation[0] == pytest.approx(near.deviation[0], rel=0.3)


REFUSED = {
    "air alone": (view_pair_fit, turn(20), {"logs": 0.0}, "nothing-seen", "air in every cell and no log"),
    "within 0.2 rad": (detector_fit, np.linspace(0.0, 0.2, 20), {}, "nothing-seen", "spread the views over more of"),
    "7 views": (view_pair_fit, turn(7), {}, "sparse-views", "7 usable views are too few to be compared: 8 are needed"),
    "at one place": (view_pair_fit, np.full(20, 0.3), {}, "sparse-views", "spread them over the turn"),
    "cut off": (view_pair_fit, turn(20), {"first": 300}, "log-cut-off", "the log reaches an end of the detector"),
    "another scanner": (detector_fit, turn(20), {"off_mm": 60.0}, "moved-too-far", "another scanner's"),
}


@pytest.mark.parametrize(("fitted", "angles", "change", "code", "sentence"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_compared_is_refused(fitted, angles, change, code, sentence):
    rng, first = np.random.default_rng(1), change.get("first", 0)
    rays, frame = averaged(angles, rows=1)
    scan = noisy(rays[:, first:], rng, rows=60) if change.get("logs", 1.0) else rng.standard_normal(rays.shape)
    start = replace(frame, cor_column_mm=frame.cor_column_mm + change.get("off_mm", 0.0))
    with pytest.raises(DriftError, match=sentence) as refusal:
        fitted(replace(MILL, num_detector_pixels=768 - first), scan, angles, start, Rotation.AS_GIVEN)
    assert refusal.value.code == code


LABORATORY = Scanner(source_to_cor_mm=410.0, num_detector_pixels=560, detector_pitch_mm=0.2)
FRAME = SourceFrame(0.0, 410.0, 554.0, -0.05, 0.003)
NOMINAL = replace(FRAME, cor_column_mm=0.0, tilt_rad=0.0)


def hardened_scan(views, seed, first=0.0, position_mm=(0.0, 0.0)):
    """A disc of 70 mm with holes, 29 % hardening on the longest path, gains of 0.3 %, noise of 0.3 %."""
    rng = np.random.default_rng(seed)
    holes = [
        Disc((12.0 * math.cos(a), 14.0 * math.sin(a)), rng.uniform(3.0, 8.0), -1.0) for a in rng.uniform(0, TAU, 3)
    ]
    body = Phantom("disc", (Disc((0.4, -0.3), 35.0, 1.0), *holes))
    angles = first + turn(views)
    rays = project(body, DetectorCells.of(LABORATORY), FRAME, angles, position_mm=position_mm)
    share = rays / rays.max()
    hard = rays * (1.0 - 0.4 * share + 0.11 * share**2)
    gains = 1.0 + 0.003 * rng.standard_normal((views, 1))
    return hard * gains + 0.003 * rays.max() * rng.standard_normal(rays.shape), angles


@pytest.mark.parametrize(("views", "worst_mm"), [(18, 0.02), (20, 0.02), (45, 0.01)])
def test_a_hard_beam_does_not_pass_for_a_log_that_moved(views, worst_mm):
    """A cell is 0.2 mm. Pairs of views alone refused such scans, or were up to a cell off."""
    errors, shares = [], []
    for seed in range(6):
        rays, angles = hardened_scan(views, seed, 0.3 * seed)
        fit = detector_fit(LABORATORY, rays, angles, NOMINAL, Rotation.AS_GIVEN)
        errors.append(fit.cor_column_mm - FRAME.cor_column_mm)
        shares.append(errors[-1] / fit.deviation[0])
    assert math.sqrt(np.mean(np.square(errors))) < worst_mm
    # The RMS of 6 standard normal numbers is below 1.8 in 99.7 % of draws.
    assert math.sqrt(np.mean(np.square(shares))) < 1.8


def test_views_with_gaps_are_compared_by_pairs_alone():
    rays, angles = hardened_scan(45, 1)
    kept = np.delete(np.arange(45), [7, 8])
    alone, fit = (
        each(LABORATORY, rays[kept], angles[kept], NOMINAL, Rotation.AS_GIVEN) for each in (view_pair_fit, detector_fit)
    )
    assert (fit.cor_column_mm, fit.deviation[0]) == (alone.cor_column_mm, alone.deviation[0])


@pytest.mark.parametrize("views", [30, 45])
def test_a_jump_of_a_cell_is_refused_even_where_hardening_hides_it_from_pairs_of_views(views):
    """Half a turn before the jump and half after it: u_c was off by a third of a cell, 9 to 13 standard deviations."""
    moved = np.where(np.arange(views)[:, None] < views // 2, 0.0, 0.148) * [-0.2, -0.98]
    rays, angles = hardened_scan(views, 2, position_mm=moved)
    with pytest.raises(DriftError, match=r"as those of a log that moved by 0\.1[2-6] mm") as refusal:
        detector_fit(LABORATORY, rays, angles, NOMINAL, Rotation.AS_GIVEN)
    assert refusal.value.code == "moved-too-far"


@pytest.mark.parametrize("seed", [4, 6, 9])
def test_where_pairs_do_not_agree_opposite_rays_answer_for_a_hard_beam_and_not_for_a_slip(seed):
    """A slip of 12 mm after nine of 20 views was reported as a move of 5.5 to 6 mm, with an error of 0.6 mm."""
    mill = replace(MILL, num_detector_pixels=384, detector_pitch_mm=3.0)
    fan = FanBeamGeometry(mill, THETA, turn(20))
    rays = project(LogModel.random(seed).slice_at(120.0).moved(5.0, -3.0), DetectorCells.of(mill), fan.frame, turn(20))
    noise = 0.004 * np.sqrt(np.mean(rays**2)) * np.random.default_rng(seed).standard_normal(rays.shape)
    hard = rays * (1.0 - 0.4 * (rays / rays.max()) ** 2) + noise
    fit = detector_fit(mill, hard, turn(20), fan.frame, Rotation.AS_GIVEN)
    assert abs(error_of(fit, fan.frame)[0]) < 3.0 * fit.deviation[0] < 1.5
    slipped = np.concatenate([rays[:9], np.roll(rays[9:], 4, axis=1)]) + noise
    with pytest.raises(DriftError, match="no geometry near the known one") as refusal:
        detector_fit(mill, slipped, turn(20), fan.frame, Rotation.AS_GIVEN)
    assert refusal.value.code == "moved-too-far"


@pytest.mark.parametrize(("views", "away"), [(20, 0.0), (20, 1e-9), pytest.param(180, 0.0, marks=pytest.mark.nightly)])
def test_views_at_0_and_at_360_degrees_stand_at_one_place(views, away):
    rays, angles = hardened_scan(views, 1)
    once_more = rays[0] + 0.004 * rays.max() * np.random.default_rng(2).standard_normal(rays[0].size)
    rays, angles = np.vstack([rays, once_more]), np.append(angles, TAU - away)
    fit = detector_fit(LABORATORY, rays, angles, NOMINAL, Rotation.AS_GIVEN)
    assert abs(fit.cor_column_mm - FRAME.cor_column_mm) < 3.0 * fit.deviation[0] < 0.1
