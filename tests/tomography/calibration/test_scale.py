"""How well the image's millimetres are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.scale import ScaleSource, ScaleUncertainty, scale_uncertainty
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import ray_error, scale_deviation
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_vocabulary import Handedness, Rotation

R_S = 859.46


def test_standard_uncertainties_add_in_quadrature_and_half_the_aspect_on_top():
    found = ScaleUncertainty(1.0, 0.1, size=0.003, statistical=0.004, aspect_half=0.001)
    # 3 and 4 make 5.
    assert found.percent_95 == pytest.approx(1.96 * 0.5 + 0.1)
    assert found.largest is ScaleSource.NOISE


def test_a_stated_size_tolerance_is_reported_as_1_96_times_it(scanner, theta):
    found = scale_uncertainty(scanner, theta.source_frame(R_S), replace(L_SHAPE, size_tolerance=0.001), None, 150.0)
    assert found.percent_95 == pytest.approx(0.196)
    unstated = scale_uncertainty(scanner, theta.source_frame(R_S), L_SHAPE, None, 150.0)
    assert unstated.percent_95 == pytest.approx(0.294)


def test_the_error_of_the_distances_counts(scanner, theta):
    frame = theta.source_frame(R_S)
    covariance = np.zeros((5, 5))
    # R and SDD off together, as a source that is farther away: R / SDD hardly changes, the scale less than by R alone.
    covariance[1:3, 1:3] = 4.0
    alone = scale_uncertainty(scanner, frame, L_SHAPE, np.diag([0.0, 4.0, 0.0, 0.0, 0.0]), 150.0)
    assert alone.statistical == pytest.approx(2.0 / frame.source_distance_mm)
    assert scale_uncertainty(scanner, frame, L_SHAPE, covariance, 150.0).statistical < 0.6 * alone.statistical


def test_a_phantom_larger_than_stated_changes_the_scale_alone(scanner, theta, full_turn):
    """Made 0.4 % larger than drawn: the rays pass, the image is 0.4 % too small, within no number but the scale's."""
    fan = FanBeamGeometry(scanner, theta, full_turn(90))
    larger = L_SHAPE.scaled(1.004)
    task = CalibrationTask(scanner, larger, simulate_sinogram(larger, fan, noise=0.02, seed=1601), fan.angles_rad)
    stated = replace(task, phantom=L_SHAPE)
    right, wrong = calibrate(task), calibrate(stated)
    apart = ray_error(task.scanner, right.frame, wrong.frame)
    # Rounding of the fit's stop.
    assert apart.rms_mm < 1e-4
    assert apart.scale_change == pytest.approx(1.0 / 1.004 - 1.0, abs=1e-6)
    assert wrong.judgement.rays_verdict == wrong.judgement.verdict == "pass"
    assert 0.29 < wrong.findings.scale.percent_95 < 0.4
    strict = calibrate(replace(stated, scale_tolerance_percent=0.2)).judgement
    assert (strict.rays_verdict, strict.verdict) == ("pass", "watch")
    assert "the phantom's size tolerance" in strict.reasons[0]


# An L of 50 mm in a scanner whose source stands straight: h_S = 0, so R is r_S.
SMALL_L = L_SHAPE.scaled(1.0 / 6.0)
STRAIGHT = SourceFrame(0.3, 410.66, 553.74, -0.05, 0.003)


@pytest.fixture(scope="module")
def small_scan(full_turn):
    """A scan of the small L with 2 % noise, for a task in which r_S is believed to be this."""
    angles, scanner = full_turn(90), Scanner(410.66, 280, 0.4)
    clean = analytic.project(SMALL_L, DetectorCells.of(scanner), STRAIGHT, angles, position_mm=(2.0, -1.0))
    spread = 0.02 * float(np.sqrt(np.mean(clean**2)))

    def task(seed, r_s=410.66):
        noise = spread * np.random.default_rng(seed).standard_normal(clean.shape)
        known = {"handedness": Handedness.AS_DRAWN, "rotation": Rotation.AS_GIVEN}
        return CalibrationTask(replace(scanner, source_to_cor_mm=r_s), SMALL_L, clean + noise, angles, **known)

    return task


def deviations_off(found):
    """The errors of R, SDD and the common scale, each in its stated standard deviations."""
    frame, bars, radius_mm = found.frame, found.findings.error_bars, found.radius_mm
    stated = bars.frame_deviation(frame)
    scale = scale_deviation(found.scanner, frame, bars.covariance.values, radius_mm=radius_mm)
    return (
        (frame.source_distance_mm - STRAIGHT.source_distance_mm) / stated[1],
        (frame.source_to_detector_mm - STRAIGHT.source_to_detector_mm) / stated[2],
        ray_error(found.scanner, STRAIGHT, frame, radius_mm=radius_mm).scale_change / scale,
    )


def test_the_scale_is_as_well_known_where_the_source_distance_was_held(small_scan):
    """R and SDD are known to 0.2 % each and their ratio to 0.005 %, whichever way the noise put R."""
    held, free = (calibrate(small_scan(seed)) for seed in (1, 0))
    assert (held.findings.source_distance.held, free.findings.source_distance.held) == (True, False)
    assert held.findings.scale.statistical == pytest.approx(free.findings.scale.statistical, rel=0.5)
    assert held.judgement.verdict == free.judgement.verdict == "pass"


def test_a_source_held_at_a_distance_that_was_measured_wrong_has_error_bars_that_cover_it(small_scan):
    """r_S 1 mm too large moves R and SDD by 0.24 % and leaves their ratio: no error above 2.6 deviations, 99 %."""
    found = calibrate(small_scan(1, r_s=411.66))
    assert found.findings.source_distance.held
    assert np.abs(deviations_off(found)).max() < 2.6
    assert found.findings.scale.statistical < 2e-4
    assert found.judgement.verdict == "pass"


@pytest.mark.nightly
@pytest.mark.parametrize("r_s", [410.66, 411.66, 413.66])
def test_the_stated_deviation_of_a_held_scale_is_of_the_error_s_size(small_scan, r_s):
    """RMS of the errors in stated deviations over the scans that were held, some eight or all of 16: 1 within 50 %."""
    found = [calibrate(small_scan(seed, r_s)) for seed in range(16)]
    scale = [deviations_off(one)[2] for one in found if one.findings.source_distance.held]
    assert len(scale) >= 4
    assert math.sqrt(np.mean(np.square(scale))) == pytest.approx(1.0, abs=0.5)
