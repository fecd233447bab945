"""A look at drift on a real store: the job's answer, and what it refuses."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_calibration.drift_checks.baselines import baselines_of, read_answers
from sawmill_calibration.drift_checks.drift_check import check_drift
from sawmill_calibration.scans.scan import Scan, rows_of_memory
from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest, CalibrationResult
from sawmill_contracts.drifts import DriftRequest, DriftResult, KnownBaseline
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec, Tolerances
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_vocabulary import DataKind
from sawmill_worker.jobs.running import run

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=384, detector_pitch_mm=3.0)
CONSTANTS = ScannerConstants(**vars(MILL))
THETA = Theta(0.7, 715.0, 180.0, 30.0, 0.15)
ANOTHER = "0" * 63 + "f"  # SHA-256 of no scan that a baseline has
TURNTABLE = replace(THETA, source_shift_mm=179.2, detector_shift_mm=30.8)


def log_scan(turn, theta=THETA, *, views=120, reverse=False, seed=4, noise=0.01):
    angles = -turn(views) if reverse else turn(views)
    log = LogModel.random(4).slice_at(120.0).moved(5.0, -3.0)
    return simulate_sinogram(log, FanBeamGeometry(MILL, theta, angles), noise=noise, seed=seed)


@pytest.fixture
def known(calibration):
    return calibration(THETA, scanner=CONSTANTS, source_frame=THETA.source_frame(859.46))


@pytest.fixture
def look(known, turn):
    def at(sinogram, angles_rad=None, **limits):
        angles = turn(len(sinogram)) if angles_rad is None else angles_rad
        return check_drift(rows_of_memory(Scan.from_arrays(sinogram, angles, MILL)), known, **limits)

    return at


def test_what_was_done_to_the_scan_is_reported(look, turn):
    faulty = log_scan(turn)
    assert look(faulty).adjustments == []
    faulty[:, 150], faulty[40] = 0.0, 30.0
    expected = ("1 detector cells", "1 corrupt views")
    assert all(words in done for words, done in zip(expected, look(faulty).adjustments, strict=True))


def test_a_scan_that_is_too_uncertain_is_reported_as_such(look, turn):
    reported = look(log_scan(turn), tolerance_mm=1e-4)
    assert reported.within_tolerance is None
    assert "Average more rows" in reported.reason


@pytest.mark.parametrize(
    ("detector_shift_mm", "noise", "within", "code", "action"),
    [
        # u_c moved by 0.1 mm on the detector, with a standard deviation of 0.25 mm: 0.1 mm of the rays is not seen.
        (30.1, 0.05, None, "log-cannot-tell", "Average more rows"),
        # The rays moved by 0.16 mm: the scanner may, and a calibration that is off by it would not pass.
        (30.25, 0.01, True, "log-shows-beyond-calibration", "Scan the phantom when the line stops next"),
        (30.05, 0.01, True, "log-shows-within", "Nothing needs to be done"),
    ],
)
def test_a_log_says_that_nothing_needs_to_be_done_only_where_a_calibration_that_far_off_would_pass(
    look, turn, detector_shift_mm, noise, within, code, action
):
    scan = log_scan(
        turn, replace(THETA, detector_shift_mm=detector_shift_mm), noise=noise, seed=3 if within is None else 4
    )
    reported = look(scan)
    assert (reported.within_tolerance, action in reported.reason) == (within, True)
    assert reported.coded_reason.code == code
    assert ("Nothing needs to be done" in reported.reason) == (code == "log-shows-within")


def test_what_a_move_costs_knots_is_stated_from_five_per_cent_on(look, turn):
    scan = log_scan(turn, replace(THETA, detector_shift_mm=33.0), noise=0.01, seed=4)
    within, beyond = look(scan, tolerance_mm=3.0), look(scan)
    cost = f"nots of 10 mm lose {within.contrast_loss.knot_10_mm_percent:.0f} % of their contrast."
    assert (within.reason[:17], cost in within.reason) == ("Calibrate soon: k", True)
    codes = within.coded_reason.code, beyond.coded_reason.code
    assert codes == ("log-shows-lost-contrast-within", "log-shows-lost-contrast")
    assert f"0.50 mm is allowed. K{cost}" in beyond.reason


@pytest.mark.slow
def test_chance_is_no_reason_for_an_alarm_and_a_large_move_is_one_though_the_scan_is_uncertain(look, turn):
    quiet = look(log_scan(turn))
    # Nothing moved; what noise makes of it is beyond this tolerance, its standard deviation is within.
    tolerance_mm = 0.5 * (quiet.ray_change_mm + quiet.ray_change_uncertainty_mm)
    chance = [look(log_scan(turn, seed=seed), tolerance_mm=tolerance_mm) for seed in range(6)]
    assert {each.within_tolerance for each in chance if each.ray_change_mm > tolerance_mm} == {None}
    assert all("Nothing needs to be done" not in each.reason for each in chance if each.within_tolerance is None)
    moved = look(log_scan(turn, TURNTABLE), tolerance_mm=0.5 * quiet.ray_change_uncertainty_mm)
    assert (moved.moved, moved.within_tolerance) == (True, False)


def test_a_log_that_turned_the_other_way_is_reported_first(look, turn):
    reported = look(log_scan(turn, reverse=True))
    assert (reported.rotation, reported.rotation_decided, reported.within_tolerance) == ("reversed", True, False)
    assert reported.rotation_ratio > 3.0
    assert "turned the other way" in reported.reason


@pytest.fixture
def asked(store, attempt, finish, send, ingest, known):
    """Upload a stack of that scanner's, and ask for drift against the known calibration; its job's attempt."""
    tolerances = Tolerances(ray_change_mm=0.25)
    store.scanners.update("line-2", ScannerSpec(name="Line 2", constants=CONSTANTS, tolerances=tolerances))

    def ask(stack, *, rows=None, deviations=None, averaged_rows=None):
        step = 360.0 / len(stack)
        content = stack if deviations is None else {"mean": np.float32(stack), "deviations": np.float32(deviations)}
        about = {"angles_deg": f"{step / 2}:{step}", "averaged_rows": averaged_rows, "phantom_id": "l-shape"}
        scan = ingest(send(content, data=DataKind.LINE_INTEGRALS, **about))
        calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
        finish(attempt(kinds.CALIBRATE), known.model_dump(mode="json", include=set(CalibrationResult.model_fields)))
        store.drifts.accept(DriftRequest(scan_id=scan.id, calibration_id=calibration.id, rows=rows))
        return attempt(kinds.DRIFT)

    return ask


def test_the_job_answers_with_what_moved(asked, turn, finish, store):
    looking = asked(np.stack([log_scan(turn, TURNTABLE), np.zeros((120, 384))], axis=1), rows="0:1")
    result = DriftResult.model_validate(run(looking))
    assert (result.views, result.rows, result.tolerance_mm) == (120, (0, 1), 0.25)
    assert not result.within_tolerance
    assert result.significance.cor_column_mm > 3.0
    assert list(looking.output.iterdir()) == []
    finish(looking, result.model_dump(mode="json"))
    stored = store.drifts.get(looking.job.subject_id).result
    assert stored == result.ended(stored.at)


def test_a_scanner_starts_from_an_imported_geometry_and_its_checks_have_no_verdict(store, send, ingest, attempt, turn):
    spec = ScannerSpec(name="Line 2", constants=CONSTANTS, imported_theta=vars(THETA), rotation="reversed")
    store.scanners.update("line-2", spec)
    stack = np.flip(log_scan(turn, TURNTABLE), 0)[:, None]
    scan = ingest(send(stack, data=DataKind.LINE_INTEGRALS, angles_deg="1.5:3"))
    store.reconstructions.accept(ReconstructionRequest(scan_id=scan.id, method="fbp", size=32, field_mm=300.0))
    assert run(attempt(kinds.RECONSTRUCT))["theta"] == pytest.approx(vars(THETA))
    store.drifts.accept(DriftRequest(scan_id=scan.id))
    found = run(attempt(kinds.DRIFT))
    assert (found["within_tolerance"], found["reference"], found["rotation"]) == (None, "given-geometry", "reversed")
    moved_mm = TURNTABLE.source_frame(859.46).cor_column_mm - THETA.source_frame(859.46).cor_column_mm
    assert found["change"]["cor_column_mm"] == pytest.approx(moved_mm, abs=0.2)


def test_the_job_takes_the_baseline_that_it_is_handed(asked, turn):
    looking = asked(log_scan(turn)[:, None])
    of_fifty = {"checks": 50, "outliers": 0, "first_at": None, "last_at": None, "tilt_offset_rad": 0.0}
    baselines = [
        KnownBaseline(method=method, cor_column_offset_mm=off, covariance=[[1e-6, 0.0], [0.0, 1e-12]], **of_fifty)
        for method, off in (("view-pairs", 0.7), ("opposite-rays", 0.2))
    ]
    given = looking.given.model_copy(update={"baselines": tuple(baselines)})
    result = DriftResult.model_validate(run(replace(looking, given=given)))
    assert (result.reference, result.method, result.baseline.method) == ("baseline", "opposite-rays", "opposite-rays")
    assert result.change.cor_column_mm - result.baseline.change.cor_column_mm == pytest.approx(0.2)


def test_twenty_views_are_compared_two_by_two(look, turn):
    still, moved = (look(log_scan(turn, theta, views=20, seed=6)) for theta in (THETA, TURNTABLE))
    assert (still.method, moved.method, look(log_scan(turn)).method) == ("view-pairs", "view-pairs", "opposite-rays")
    assert abs(still.change.cor_column_mm) < 4.0 * still.change_standard_deviation.cor_column_mm
    expected = TURNTABLE.source_frame(859.46).cor_column_mm - THETA.source_frame(859.46).cor_column_mm
    assert abs(moved.change.cor_column_mm - expected) < 4.0 * moved.change_standard_deviation.cor_column_mm < 0.5
    assert (still.moved, moved.moved) == (False, True)
    assert all(any(part in blind for blind in still.not_seen) for part in ("flat field", "distance R", "psi"))
    assert still.change_standard_deviation.source_to_detector_mm is None


def test_the_mean_of_the_rows_is_answered_as_the_stack_is(asked, turn, finish, store):
    rows = log_scan(turn, TURNTABLE, views=20)[:, None] + 0.01 * np.random.default_rng(5).standard_normal((20, 40, 384))
    asked_first = asked(rows)
    finish(asked_first, run(asked_first))
    of_stack = store.drifts.get(asked_first.job.subject_id).result
    looking = asked(rows.mean(axis=1), averaged_rows=40)
    of_mean = DriftResult.model_validate(run(looking))
    assert of_mean.change.cor_column_mm == pytest.approx(of_stack.change.cor_column_mm, abs=1e-4)
    assert of_mean.moved
    came, masked = of_mean.adjustments
    assert came == "It came as the mean of the line integrals of 40 rows, without standard deviations."
    assert "No ray of it was masked" in masked
    assert store.scans.get(looking.given.scan.id).remarks == of_mean.adjustments
    # 20 views of 384 cells: what is sent is no more than their numbers and a header.
    assert looking.given.scan.size_bytes == 4 * 20 * 384 + 128


def test_a_nail_that_the_sender_masks_moves_nothing(asked, turn, finish, store):
    """A shadow of six cells that goes round with the log."""
    rays, deviations = log_scan(turn, views=20), np.full((20, 384), 0.01)
    at = (192 + 40 * np.sin(turn(20))).astype(int)[:, None] + np.arange(6)
    nailed, masked = rays.copy(), deviations.copy()
    nailed[np.arange(20)[:, None], at] += 0.4
    masked[np.arange(20)[:, None], at] = np.inf
    looked = []
    for mean, known in ((rays, deviations), (nailed, masked)):
        looking = asked(mean, deviations=known, averaged_rows=300)
        finish(looking, run(looking))
        looked.append(store.drifts.get(looking.job.subject_id).result)
    sound, mended = looked
    uncertain = mended.change_standard_deviation.cor_column_mm
    assert abs(mended.change.cor_column_mm - sound.change.cor_column_mm) < 2.0 * uncertain
    assert uncertain > sound.change_standard_deviation.cor_column_mm
    assert not mended.moved
    assert mended.adjustments[1] == "120 of 7680 rays were masked, and interpolated along the detector."


def test_a_refusal_names_the_masked_rays(asked, turn):
    rays = log_scan(turn, views=20)
    rays[9:] = np.roll(rays[9:], 4, axis=1)
    rays[4, 190:210] = np.nan
    with pytest.raises(JobFailure, match=r"20 of 7680 rays were masked, .* Wide masks do that too"):
        run(asked(rays, averaged_rows=300))


def test_of_a_mean_no_rows_can_be_chosen(asked, turn):
    with pytest.raises(JobFailure, match="the scan is the mean of 300 rows, which are not kept: leave rows out"):
        run(asked(log_scan(turn, views=20), averaged_rows=300, rows="0:1"))


def test_a_calibration_of_another_detector_is_refused(asked, turn, store):
    looking = asked(log_scan(turn)[:, None])
    wider = replace(store.scanners.get("line-2").constants, detector_pitch_mm=3.1)
    store.scanners.update("line-2", ScannerSpec(name="Line 2", constants=wider))
    with pytest.raises(JobFailure, match=r"with detector_pitch_mm 3 and the scan has 3\.1") as failure:
        run(replace(looking, given=store.jobs.handed_over(looking.job.id)))
    assert failure.value.code == "contradiction"


def test_a_calibration_that_was_cancelled_is_refused(asked, turn, store, attempt):
    scan = store.scans.get(asked(log_scan(turn)[:, None]).given.scan.id)
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
    store.drifts.accept(DriftRequest(scan_id=scan.id, calibration_id=calibration.id), identifier="late")
    store.jobs.request_cancel(calibration.job_id)
    with pytest.raises(JobFailure, match="is cancelled and has no geometry to compare with"):
        run(attempt(kinds.DRIFT))


def test_the_tilt_is_reported_in_the_units_of_its_name(look, turn):
    reported = look(log_scan(turn, replace(THETA, detector_tilt=0.16)))
    expected = math.atan(0.16) - math.atan(0.15)
    assert reported.change.tilt_rad == pytest.approx(expected, abs=6.0 * reported.change_standard_deviation.tilt_rad)
    assert reported.moved


@pytest.fixture
def disturbed(look, turn):
    """A look at a part turn of a log with an odd error of the flat field, which opposite rays would show all round."""
    across = (np.arange(MILL.num_detector_pixels) - 150.0) / 25.0
    odd = 0.02 * across * np.exp(-(across**2))

    def of(seed, theta=THETA, **changes):
        log = LogModel.random(seed).slice_at(120.0).moved(6.0 * math.cos(seed), 6.0 * math.sin(seed))
        angles = turn(24)[:20]
        rays = simulate_sinogram(log, FanBeamGeometry(MILL, theta, angles), noise=0.004, seed=seed) - odd
        return look(rays, angles_rad=angles, **changes)

    return of


@pytest.fixture
def answers(disturbed, tmp_path):
    """What checks of three logs after the calibration printed."""
    paths = [tmp_path / f"{seed}.json" for seed in range(3)]
    for seed, path in enumerate(paths):
        result = disturbed(seed).model_copy(update={"input_sha256": f"{seed:064}"})
        path.write_text(json.dumps({"state": "succeeded"} | result.model_dump(mode="json")))
    return paths


def test_a_baseline_cancels_what_stays_and_shows_what_moves(disturbed, answers, known):
    baselines = baselines_of(read_answers(answers), known, ANOTHER)
    still = disturbed(7, baselines=baselines)
    moved = disturbed(7, replace(THETA, detector_shift_mm=30.4), baselines=baselines)
    assert abs(still.significance.cor_column_mm) > 4.0, "absolute, a scanner that stands seems to have moved"
    assert (still.reference, still.moved, still.baseline.checks) == ("baseline", False, 3)
    assert abs(still.baseline.significance.cor_column_mm) < 3.0
    assert still.ray_change_mm < 0.3 * still.baseline.ray_offset_mm
    assert "counted from the first 3 logs after the calibration" in still.reason
    assert any("newer than the baseline" in blind for blind in still.not_seen)
    expected = replace(THETA, detector_shift_mm=30.4).source_frame(859.46).cor_column_mm
    expected -= THETA.source_frame(859.46).cor_column_mm
    assert (moved.moved, moved.within_tolerance) == (True, True)
    assert moved.baseline.change.cor_column_mm - still.baseline.change.cor_column_mm == pytest.approx(expected, abs=0.1)


def test_a_baseline_out_of_tolerance_hides_no_move_before_it(disturbed, answers, known):
    (baseline,) = baselines_of(read_answers(answers), known, ANOTHER)
    beyond = disturbed(7, baselines=(baseline,), tolerance_mm=0.5 * disturbed(7).ray_change_mm)
    assert beyond.within_tolerance is False
    assert beyond.ray_change_mm < beyond.tolerance_mm < beyond.baseline.ray_offset_mm
    assert "Take a new flat field, scan the phantom" in beyond.reason


def test_answers_that_make_no_baseline_are_refused(answers, known, tmp_path):
    def refusal(*paths, calibration=known, checked=ANOTHER):
        with pytest.raises(JobFailure) as caught:
            baselines_of(read_answers(paths), calibration, checked)
        assert (caught.value.kind, caught.value.code) == (FailureKind.INPUT, "baseline")
        return caught.value.detail

    first = json.loads(answers[0].read_text())

    def changed(**changes):
        path = tmp_path / "changed.json"
        path.write_text(json.dumps({"id": "example", "result": first | changes}))
        return path

    assert "2 looks make no baseline: 3 or more are needed" in refusal(*answers[:2])
    assert "1.json is of the scan that is checked" in refusal(*answers, checked=f"{1:064}")
    assert "1.json" not in refusal(answers[0], answers[0])
    assert "an earlier answer is of" in refusal(answers[0], changed())
    other = known.model_copy(update={"source_frame": TURNTABLE.source_frame(859.46)})
    assert "against another calibration" in refusal(*answers, calibration=other)
    assert "the other way" in refusal(changed(rotation="reversed"))
    assert "how views were compared" in refusal(changed(method=None))
    (tmp_path / "no.json").write_text("[]")
    assert "no.json is not what drift --json prints" in refusal(tmp_path / "no.json")
    (tmp_path / "no.json").write_text('{"views": 20}')
    assert "Field required" in refusal(tmp_path / "no.json")
