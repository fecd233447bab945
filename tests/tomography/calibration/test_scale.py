"""How well the image's millimetres are known."""

from dataclasses import replace

import numpy as np
import pytest

from sawmill_worker.tomography.built_in import L_SHAPE
from sawmill_worker.tomography.calibration.calibrate import calibrate
from sawmill_worker.tomography.calibration.scale import ScaleSource, ScaleUncertainty, scale_uncertainty
from sawmill_worker.tomography.calibration.task import CalibrationTask
from sawmill_worker.tomography.geometry import FanBeamGeometry
from sawmill_worker.tomography.ray_error import ray_error
from sawmill_worker.tomography.simulate import simulate_sinogram

R_S = 859.46


def test_standard_uncertainties_add_in_quadrature_and_half_the_aspect_on_top():
    found = ScaleUncertainty(1.0, 0.1, size=0.003, statistical=0.004, aspect_half=0.001)
    # 3 and 4 make 5.
    assert found.percent_95 == pytest.approx(1.96 * 0.5 + 0.1)
    assert found.largest is ScaleSource.NOISE


def test_a_stated_size_tolerance_is_reported_as_1_96_times_it(scanner, theta):
    measured = replace(L_SHAPE, size_tolerance=0.001)
    found = scale_uncertainty(scanner, theta.source_frame(R_S), measured, None, 150.0)
    assert found.percent_95 == pytest.approx(0.196)
    unstated = scale_uncertainty(scanner, theta.source_frame(R_S), L_SHAPE, None, 150.0)
    assert unstated.percent_95 == pytest.approx(0.294)


def test_the_error_of_the_distances_counts(scanner, theta):
    frame = theta.source_frame(R_S)
    covariance = np.zeros((5, 5))
    # R and SDD off together, as a source that is farther away: R / SDD hardly changes, the scale less than by R alone.
    covariance[1:3, 1:3] = 4.0
    together = scale_uncertainty(scanner, frame, L_SHAPE, covariance, 150.0)
    alone = scale_uncertainty(scanner, frame, L_SHAPE, np.diag([0.0, 4.0, 0.0, 0.0, 0.0]), 150.0)
    assert alone.statistical == pytest.approx(2.0 / frame.source_distance_mm)
    assert together.statistical < 0.6 * alone.statistical


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
    assert 0.29 < wrong.scale.percent_95 < 0.4
    strict = calibrate(replace(stated, scale_tolerance_percent=0.2)).judgement
    assert (strict.rays_verdict, strict.verdict) == ("pass", "watch")
    assert "the phantom's size tolerance" in strict.reasons[0]
