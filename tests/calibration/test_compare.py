"""What changed between calibrations: the active one and a new one, and several of one scanner."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_calibration.calibration.calibrate import CalibrationInput, calibration_result, run_calibration
from sawmill_calibration.calibration.calibrate_scan import compared, geometry_of
from sawmill_calibration.calibration.repeatability import repeatability
from sawmill_contracts.calibrations import CalibrationOptions, PredictedRayError
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS
from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_tomography.geometry.ray_error import ray_error


def watched(spec, **tolerances) -> StoredScanner:
    known = dict(spec(**tolerances))
    return StoredScanner(id="line-2", created_at="2030-01-01T00:00:00Z", active_calibration_id="found", **known)


@pytest.fixture
def knocked(calibration, theta):
    """The calibration of that scanner with its detector 2 mm aside."""
    return calibration(replace(theta, detector_shift_mm=theta.detector_shift_mm - 2.0))


def compare(active, new, scanner):
    return compared(active, geometry_of(new), scanner)


def test_the_same_geometry_and_its_twin_have_not_moved_and_a_knock_is_reported_in_millimetres(
    calibration, spec, theta, knocked
):
    for same in (theta, theta.twin(859.46)):
        change = compare(calibration(), calibration(same), watched(spec))
        assert change.ray_change_mm < 1e-6
        assert change.within_tolerance
        assert "within the 0.50 mm allowed" in change.reason
    change = compare(calibration(), knocked, watched(spec))
    expected = knocked.source_frame.cor_column_mm - calibration().source_frame.cor_column_mm
    assert change.cor_column_change_mm == pytest.approx(expected)
    assert change.ray_change_mm > 0.5
    assert not change.within_tolerance
    assert f"The COR moved {expected:+.2f} mm on the detector" in change.reason


@pytest.mark.parametrize(("stated_mm", "counted_mm"), [(None, 50.0), (100.0, 100.0)])
def test_rays_are_compared_in_the_scanner_s_disc_else_in_the_active_calibration_s(
    calibration, spec, theta, scanner, stated_mm, counted_mm
):
    error = PredictedRayError(rms=0, max=0, upper_95=0, radius_mm=50)
    active = calibration().model_copy(update={"predicted_ray_error_mm": error})
    new = calibration(replace(theta, detector_tilt=theta.detector_tilt + 0.02))
    change = compare(active, new, watched(spec).model_copy(update={"log_radius_mm": stated_mm}))
    expected = ray_error(scanner, active.source_frame, new.source_frame, radius_mm=counted_mm)
    assert change.ray_change_mm == pytest.approx(expected.rms_mm)


@pytest.mark.parametrize("ray_change_mm", [0.5, 1e3])
def test_out_of_tolerance_is_the_first_reason_of_the_answer(
    calibration, spec, theta, constants, sinogram, turn, ray_change_mm
):
    given = CalibrationInput(
        sinogram(turn(24)), turn(24), (0, 1), constants, None, BUILT_IN_PHANTOMS["l-shape"], "0" * 64
    )
    given, found = run_calibration(given, CalibrationOptions(), lambda _: None)
    active = calibration(replace(theta, detector_shift_mm=theta.detector_shift_mm - 20.0))
    # Such a shift turns the ray through the COR, and with it the lengths along it: the scale changes by 1.2 %.
    change = compared(active, found.geometry, watched(spec, ray_change_mm=ray_change_mm, scale_percent=2.0))
    answer = calibration_result(found, given, change)
    moved = [] if change.within_tolerance else [change.reason]
    assert change.within_tolerance == (ray_change_mm > 1.0)
    assert (answer.reasons, answer.comparison) == ([*moved, *found.judgement.reasons], change)


def test_the_error_bars_of_both_calibrations_count_and_the_scanners_tolerance_decides(calibration, spec, knocked):
    vague = {"covariance": np.diag([1e-6, 400.0, 400.0, 1e-4, 1e-6]).tolist()}
    assert "and the tilt did not" in compare(calibration(**vague), knocked, watched(spec)).reason
    ray_change = compare(calibration(), knocked, watched(spec)).ray_change_mm
    assert compare(calibration(), knocked, watched(spec, ray_change_mm=1.01 * ray_change)).within_tolerance
    assert not compare(calibration(), knocked, watched(spec, ray_change_mm=0.99 * ray_change)).within_tolerance


def resized(calibration, percent: float, deviation_mm: float):
    """A calibration and the same with a phantom larger by this, R known to this number of mm in either."""
    known = calibration(covariance=np.diag([1e-6, deviation_mm**2, 1e-2, 1e-4, 1e-8]).tolist())
    frame = known.source_frame
    larger = replace(frame, source_distance_mm=frame.source_distance_mm * (1.0 + percent / 100.0))
    return known, known.model_copy(update={"source_frame": larger})


def test_a_change_of_scale_is_no_ray_error_but_is_reported(calibration, spec):
    """Wood that swells by 0.3 % enlarges the image by 0.3 % and doubles or blurs nothing."""
    known, larger = resized(calibration, 0.3, 0.3)
    change = compare(known, larger, watched(spec))
    assert change.ray_change_mm < 1e-9
    assert change.scale_change_percent == pytest.approx(0.3)
    # 0.3 mm of about 900 in either, nearly all of it: 1.96 sqrt(2) 0.3 / 900.
    assert change.scale_change_uncertainty_percent == pytest.approx(0.092, rel=0.1)
    assert change.within_tolerance
    assert "The scale changed by +0.300 ± 0.0" in change.reason
    assert "dried or swelled" in change.reason


def test_a_change_of_scale_beyond_its_tolerance_is_a_movement_and_within_its_error_bars_not_mentioned(
    calibration, spec
):
    assert "scale" not in compare(*resized(calibration, 0.3, 2.0), watched(spec)).reason
    change = compare(*resized(calibration, 0.6, 0.3), watched(spec))
    assert not change.within_tolerance
    assert "0.50 % is allowed." in change.reason
    assert "The source distance changed" in change.reason
    assert "phantom's size is not the stated one: the source shift would be" in change.reason
    assert "as with a phantom 0.6 % smaller than its drawing" in change.reason
    assert compare(*resized(calibration, 0.6, 0.3), watched(spec, scale_percent=0.7)).within_tolerance


def test_a_log_that_turns_the_other_way_is_reported_first(calibration, spec):
    change = compare(calibration(), calibration(rotation="reversed"), watched(spec))
    assert not change.within_tolerance
    assert "turns the other way" in change.reason


def test_the_first_angle_counts_only_where_it_has_a_tolerance(calibration, spec, theta):
    turned = calibration(replace(theta, initial_angle_rad=theta.initial_angle_rad + math.radians(1.5)))
    free, held = watched(spec), watched(spec, angle_change_deg=1.0)
    assert compare(calibration(), turned, free).within_tolerance
    change = compare(calibration(), turned, held)
    assert change.angle_change_deg == pytest.approx(1.5)
    assert not change.within_tolerance
    assert "+1.500 degrees" in change.reason
    assert compare(calibration(), turned, watched(spec, angle_change_deg=2.0)).within_tolerance


def test_an_angle_that_wraps_is_small_and_rays_that_left_the_log_moved_by_more_than_its_radius(
    calibration, spec, theta
):
    before = calibration(replace(theta, initial_angle_rad=0.001))
    change = compare(before, calibration(replace(theta, initial_angle_rad=2 * math.pi - 0.001)), watched(spec))
    assert change.angle_change_deg == pytest.approx(-math.degrees(0.002))
    away = calibration(replace(theta, detector_shift_mm=theta.detector_shift_mm - 3000.0))
    change = compare(away, calibration(), watched(spec))
    assert change.ray_change_mm >= 150.0
    assert not change.within_tolerance


# Standard deviations of psi, R, SDD, u_c and tau, rad and mm.
COVARIANCE = (np.diag([1e-4, 0.5, 0.8, 0.02, 5e-4]) ** 2).tolist()
PREDICTED = PredictedRayError(rms=0.02, max=0.04, upper_95=0.03, radius_mm=150.0)


@pytest.fixture
def result(calibration, theta):
    """A calibration whose R, as a share, and u_c are off by so much."""

    def of(longer=0.0, column_mm=0.0, covariance=COVARIANCE):
        frame = theta.source_frame(859.46)
        r_mm, u_c_mm = frame.source_distance_mm * (1.0 + longer), frame.cor_column_mm + column_mm
        off = replace(frame, source_distance_mm=r_mm, cor_column_mm=u_c_mm)
        return calibration(source_frame=off, covariance=covariance, predicted_ray_error_mm=PREDICTED)

    return of


def test_calibrations_that_differ_by_their_noise_are_repeatable_and_a_moved_centre_or_another_scale_is_not(result):
    found = repeatability([("a", result()), ("b", result(column_mm=0.01)), ("c", result(column_mm=-0.01))])
    assert found.verdict == "repeatable"
    assert [(pair.first, pair.second) for pair in found.pairs] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert found.pairs[0].cor_column_difference_mm == pytest.approx(0.01)
    assert found.pairs[0].cor_column_deviation_mm == pytest.approx(0.02 * np.sqrt(2.0))
    (moved,) = repeatability([("a", result()), ("b", result(column_mm=0.4))]).pairs
    (larger,) = repeatability([("a", result()), ("b", result(longer=0.004))]).pairs
    assert not moved.within_error_bars
    assert moved.ray_difference_mm > moved.expected_95_mm
    assert not larger.within_error_bars
    assert larger.ray_difference_mm < 1e-3  # a common scale moves no ray among the others
    assert larger.scale_difference_percent == pytest.approx(0.4, rel=1e-3)


def test_pairs_of_many_calibrations_that_differ_by_their_errors_alone_agree(result):
    """Some of 276 pairs lie beyond their own 95 %: the limit allows for the largest of all, and a move still shows."""
    frame = result().source_frame
    draws = np.random.default_rng(27).multivariate_normal(np.zeros(5), COVARIANCE, size=24)
    drawn = [result(of[1] / frame.source_distance_mm, of[3]) for of in draws]
    named = [(str(number), calibration) for number, calibration in enumerate(drawn)]
    found = repeatability(named)
    alone = [pair for pair in found.pairs if pair.ray_difference_mm > pair.expected_95_mm]
    assert (len(found.pairs), len(alone) > 0, found.verdict) == (276, True, "repeatable")
    moved = repeatability([*named[:3], ("moved", result(column_mm=0.4))])
    assert moved.verdict == "beyond-error-bars"
    assert all("moved" in (pair.first, pair.second) for pair in moved.pairs if not pair.within_error_bars)


def test_what_cannot_be_compared_is_refused(result):
    with pytest.raises(JobFailure, match="two or more"):
        repeatability([("a", result())])
    with pytest.raises(JobFailure, match="no error bars"):
        repeatability([("a", result()), ("b", result(covariance=None))])
