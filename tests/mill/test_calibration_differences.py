"""The differences of two calibrations, and how certain each is."""

import math

import pytest
from results import FRAME, THETA, calibration_result

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_mill.calibration_differences import differences

SPREADS = {"theta": dict.fromkeys(THETA, 0.1), "source_frame": dict.fromkeys(FRAME, 0.1)}


def calibration(spreads=SPREADS, **frame):
    answer = calibration_result(source_frame=FRAME | frame, standard_deviation=spreads)
    return CalibrationResult.model_validate(answer)


def test_a_change_is_certain_beyond_both_error_bars_together():
    moved = calibration(cor_column_mm=FRAME["cor_column_mm"] + 0.3, tilt_rad=FRAME["tilt_rad"] - 0.2)
    found = {each.name: each for each in differences(calibration(), moved)}
    assert {name: each.change for name, each in found.items()} == pytest.approx(
        {
            "psi_rad": 0.0,
            "source_distance_mm": 0.0,
            "source_to_detector_mm": 0.0,
            "cor_column_mm": 0.3,
            "tilt_rad": -0.2,
        }
    )
    # 95 % of a normal distribution whose variance is that of both.
    assert found["cor_column_mm"].error == pytest.approx(1.96 * math.sqrt(0.02))
    assert (found["cor_column_mm"].is_certain, found["tilt_rad"].is_certain) == (True, False)


def test_the_first_angle_goes_the_shorter_way_round():
    angle, *_ = differences(calibration(psi_rad=0.01), calibration(psi_rad=math.tau - 0.02))
    assert angle.change == pytest.approx(-0.03)


def test_without_an_error_bar_nothing_is_certain():
    held = SPREADS | {"source_frame": SPREADS["source_frame"] | {"source_distance_mm": None}}
    of_r = next(each for each in differences(calibration(), calibration(held)) if each.name == "source_distance_mm")
    assert (of_r.error, of_r.is_certain) == (None, None)
