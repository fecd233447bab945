"""A phantom that moves during its scan, and angles that are not those of the turntable: reported, and fitted."""

from dataclasses import replace

import numpy as np
import pytest
from family_scans import OTHER_MOTIONS, otherwise_moved
from missing_parts import first_by_day

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import TAU, Scanner, Theta
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import BUILT_IN, L_SHAPE
from sawmill_tomography.phantoms.phantom import Disc
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Adjustment

pytestmark = pytest.mark.slow

SCANNER = Scanner(859.46, 384, 3.0)
FRAME = Theta(1.2, 741.0, 212.0, 31.0, 0.17).source_frame(859.46)
VIEWS = 72
ANGLES = (np.arange(VIEWS) + 0.5) * TAU / VIEWS


def shadow(angles, *, body=L_SHAPE, turn_deg=0.0, at=(0.0, 0.0)):
    frame = replace(FRAME, psi_rad=FRAME.psi_rad + np.deg2rad(turn_deg))
    return analytic.project(body, DetectorCells.of(SCANNER), frame, angles, position_mm=at, rays_per_cell=6)


def moved(view, *, turn_deg, at):
    return np.concatenate([shadow(ANGLES[:view]), shadow(ANGLES[view:], turn_deg=turn_deg, at=at)])


def calibrated(sinogram, seed, *, without=(), noise=0.01):
    scatter = np.random.default_rng(seed).standard_normal(sinogram.shape)
    scan = sinogram + noise * np.sqrt(np.mean(sinogram**2)) * scatter
    # Tolerated is what a scan of this size is calibrated to anyway.
    return calibrate(CalibrationTask(SCANNER, L_SHAPE, scan, ANGLES, tolerance_mm=0.1, without=without))


def error_mm(found):
    return ray_error(SCANNER, FRAME, found.frame).rms_mm


def otherwise(motion, seed):
    """The codes of the first reason, the verdict and the true error of a phantom that moves otherwise."""
    making = otherwise_moved(motion, seed)
    found = calibrate(making.task(seed), seed=seed)
    true = ray_error(making.scanner, making.frame, found.frame, other_scanner=found.scanner, radius_mm=found.radius_mm)
    return [each.codes for each in found.judgement.reasons[:1]], found.judgement.verdict, true.rms_mm


def test_a_phantom_that_leans_and_settles_is_named():
    """Without this motion in the model it was taken for a scanner that moves, and the rays were 0.12 mm off."""
    codes, verdict, true_mm = otherwise("lean", 4)
    assert true_mm < 0.05
    assert ("phantom-settles" in codes[0], verdict) == (True, "pass")


@pytest.mark.parametrize("seed", [123, 128, 205, 214, 221])
def test_a_phantom_that_slips_three_times_is_watched_where_other_motions_explain_it(seed):
    """Two of its slips, one, a wobble, or waves in time, were fitted, and the scan passed 0.11 to 0.17 mm off."""
    _, verdict, true_mm = otherwise("three slips", seed)
    assert (verdict, true_mm > 0.1) == ("watch", True)


@pytest.mark.parametrize(("seed", "verdict"), [(1, "watch"), (6, "fail")])
def test_a_phantom_that_moves_in_no_simple_way_is_named_and_its_bound_holds(seed, verdict):
    """A random walk of 0.04 mm a view was a wobble and a slip: with seed 6 0.19 mm off, with a bound of 0.055."""
    walk_mm = np.cumsum(0.04 * np.random.default_rng(seed).standard_normal((VIEWS, 2)), axis=0)
    found = calibrated(shadow(ANGLES, at=walk_mm), seed)
    assert any("phantom-unsteady" in each.codes for each in found.adjustments)
    assert error_mm(found) < found.findings.error_bars.predicted_ray_error.upper_95_mm
    assert found.judgement.verdict == verdict


@pytest.mark.nightly
@pytest.mark.parametrize("motion", OTHER_MOTIONS)
def test_phantoms_that_move_otherwise_do_not_pass_with_wrong_rays(motion):
    scans = [otherwise(motion, seed) for seed in range(100, 120)]
    assert not [codes for codes, verdict, true_mm in scans if verdict == "pass" and true_mm > 0.1]


# 1 % noise and 72 views predict 0.004 mm; what is fitted as well leaves no more than a few times that.
LIMIT_MM = 0.02


@pytest.mark.parametrize(("view", "mm"), [(20, 0.4), (50, 2.0), (40, 8.0)])
def test_a_phantom_that_slips_is_reported_with_the_view_and_how_far(view, mm):
    found = calibrated(moved(view, turn_deg=0.1 * mm, at=(0.8 * mm, -0.6 * mm)), 1301)
    reason = next(reason for reason in found.judgement.reasons if "phantom moved at view" in reason)
    reported_view, reported_mm = (reason.parts[0].values[name] for name in ("view", "slip_mm"))
    # A slip is found to the view but for the few that noise gives or takes.
    assert abs(reported_view - view) <= 2
    assert reported_mm == pytest.approx(mm, rel=0.1)
    assert error_mm(found) < min(LIMIT_MM, found.findings.error_bars.predicted_ray_error.upper_95_mm)


@pytest.mark.parametrize(("view", "mm"), [(20, 0.4), (40, 8.0)])
def test_a_slip_that_is_not_fitted_is_reported_and_in_the_error_bars(view, mm):
    found = calibrated(moved(view, turn_deg=0.1 * mm, at=(0.8 * mm, -0.6 * mm)), 1301, without=tuple(Adjustment))
    reason = next(reason for reason in found.judgement.reasons if "phantom moved at view" in reason)
    assert "It was not fitted, and the rays are off by" in reason
    assert found.judgement.verdict != "pass"
    assert 0.1 < error_mm(found) < found.findings.error_bars.predicted_ray_error.upper_95_mm


@pytest.mark.parametrize(
    ("angles", "turn_deg", "cause"),
    [
        (ANGLES * 1.006, 0.0, "The turntable turns 1.006"),
        (ANGLES + np.deg2rad(0.6) * np.cos(ANGLES + 0.7), 0.0, "The angles are ahead and behind once a turn, by 0.6"),
        (ANGLES, 1.0, "The angles jump by "),
    ],
)
def test_angles_that_are_not_the_turntable_s_are_reported(angles, turn_deg, cause):
    found = calibrated(np.concatenate([shadow(angles[:36]), shadow(angles[36:], turn_deg=turn_deg)]), 1302)
    assert any(reason.startswith(cause) for reason in found.judgement.reasons), found.judgement
    assert error_mm(found) < min(LIMIT_MM, found.findings.error_bars.predicted_ray_error.upper_95_mm)


@pytest.mark.parametrize("seed", range(1310, 1313))
def test_steady_scans_are_called_nothing_else(seed):
    knot = replace(L_SHAPE, shapes=(*L_SHAPE.shapes, Disc((50.0, -60.0), 12.0, 0.35)))
    plain = calibrated(shadow(ANGLES), seed)
    assert plain.judgement.verdict == "pass"
    for found in (plain, calibrated(shadow(ANGLES, body=knot), seed)):
        assert not any("phantom moved" in reason or "The angles" in reason for reason in found.judgement.reasons)


@pytest.mark.parametrize("views", [45, 180])
@pytest.mark.parametrize("phantom", BUILT_IN.values(), ids=BUILT_IN)
@pytest.mark.parametrize("scanner", first_by_day(1, [Scanner(859.46, 128, 9.0), SCANNER]), ids=["128", "384"])
def test_a_model_finer_than_the_scan_is_no_unsteadiness(scanner, phantom, views):
    """One ray a cell, where the model takes the mean over each: off at the edges, and differently in every view."""
    angles = (np.arange(views) + 0.5) * TAU / views
    clean = analytic.project(phantom, DetectorCells.of(scanner), FRAME, angles, rays_per_cell=1)
    noise = 0.005 * clean.std() * np.random.default_rng(1320).standard_normal(clean.shape)
    found = calibrate(CalibrationTask(scanner, phantom, clean + noise, angles))
    assert not any("phantom moved" in reason or "The angles" in reason for reason in found.judgement.reasons)


@pytest.mark.parametrize("views", [4, 9, 10, 12])
def test_few_views_are_calibrated_all_the_same(views):
    angles = (np.arange(views) + 0.5) * TAU / views
    clean = analytic.project(L_SHAPE, DetectorCells.of(SCANNER), FRAME, angles, rays_per_cell=6)
    noise = 0.005 * clean.std() * np.random.default_rng(1330).standard_normal(clean.shape)
    found = calibrate(CalibrationTask(SCANNER, L_SHAPE, clean + noise, angles))
    assert found.judgement.verdict == "pass", found.judgement.reasons
