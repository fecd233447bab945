"""The two questions beside every verdict, and the differences of two calibrations with how certain each is."""

import math

import pytest
from results import FRAME, THETA, calibration_result

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.scanners import Tolerances
from sawmill_mill.calibration_differences import differences
from sawmill_mill.two_questions import Answer, TwoQuestions

LIMITS = {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5}
PREDICTED = {"rms": 0.02, "max": 0.05, "upper_95": 0.04, "radius_mm": 150.0}


def questions(tolerances=None, **changes):
    answer = calibration_result(**{"limits": LIMITS, "rays_verdict": "pass"} | changes)
    return TwoQuestions.of(CalibrationResult.model_validate(answer), tolerances)


def test_numbers_stand_beside_their_limits_and_the_scale_becomes_mm_on_the_largest_log():
    both = questions()
    assert both.rays.answer is both.millimetres.answer is Answer.YES
    # 0.3 % and 0.5 % of a log of 2 x 150 mm.
    assert both.millimetres.on_diameter_mm == pytest.approx(0.9)
    assert both.millimetres.limit_on_diameter_mm == pytest.approx(1.5)
    assert both.rays.sentence() == "In 95 of 100 cases the rays are off by less than 0.040 mm; 0.100 mm is allowed."
    assert both.millimetres.sentence() == "Sizes are right to 0.3 %: 0.9 mm on a log of 300 mm; 0.5 % is allowed."


@pytest.mark.parametrize(
    ("changes", "rays", "millimetres"),
    [
        ({"rays_verdict": "watch", "predicted_ray_error_mm": PREDICTED | {"upper_95": 0.2}}, "look", "yes"),
        ({"rays_verdict": "watch"}, "look", "yes"),
        ({"rays_verdict": "fail"}, "no", "yes"),
        ({"predicted_ray_error_mm": None}, "unknown", "yes"),
        ({"scale_uncertainty_percent": 1.2}, "yes", "look"),
        ({"scale_uncertainty_percent": None}, "yes", "unknown"),
        ({"limits": None}, "yes", "unknown"),
        ({"status": "inconsistent-scale", "rays_verdict": "fail"}, "no", "no"),
        ({"status": "not-converged", "rays_verdict": "fail"}, "no", "unknown"),
    ],
)
def test_each_answer_has_a_word_and_a_whole_sentence(changes, rays, millimetres):
    both = questions(**changes)
    assert (both.rays.answer, both.millimetres.answer) == (rays, millimetres)
    for sentence in (both.rays.sentence(), both.millimetres.sentence()):
        assert sentence.endswith(".")
        assert "%(" not in sentence


def test_an_answer_of_an_earlier_version_is_held_against_the_scanner():
    both = questions(Tolerances(predicted_ray_error_mm=0.03, scale_percent=0.2), limits=None, rays_verdict=None)
    assert (both.rays.limit_mm, both.rays.within) == (0.03, False)
    assert both.rays.answer is both.millimetres.answer is Answer.LOOK


def test_a_language_gives_its_words_and_its_decimals():
    sentence = questions().rays.sentence
    catalogue = {questions().rays.message: "Säteet: %(bound)s / %(limit)s"}
    said = sentence(words=catalogue.__getitem__, mm=lambda value: f"{value:.3f} mm".replace(".", ","))
    assert said == "Säteet: 0,040 mm / 0,100 mm"


SPREADS = {"theta": dict.fromkeys(THETA, 0.1), "source_frame": dict.fromkeys(FRAME, 0.1)}


def calibration(spreads=SPREADS, **frame):
    answer = calibration_result(source_frame=FRAME | frame, standard_deviation=spreads)
    return CalibrationResult.model_validate(answer)


def test_a_change_is_certain_beyond_both_error_bars_together():
    moved = calibration(cor_column_mm=FRAME["cor_column_mm"] + 0.3, tilt_rad=FRAME["tilt_rad"] - 0.2)
    found = {each.name: each for each in differences(calibration(), moved)}
    changes = dict.fromkeys(("psi_rad", "source_distance_mm", "source_to_detector_mm"), 0.0)
    changes |= {"cor_column_mm": 0.3, "tilt_rad": -0.2}
    assert {name: each.change for name, each in found.items()} == pytest.approx(changes)
    # 95 % of a normal distribution whose variance is that of both.
    assert found["cor_column_mm"].error == pytest.approx(1.96 * math.sqrt(0.02))
    assert (found["cor_column_mm"].is_certain, found["tilt_rad"].is_certain) == (True, False)


def test_the_first_angle_goes_the_shorter_way_round_and_without_an_error_bar_nothing_is_certain():
    angle, *_ = differences(calibration(psi_rad=0.01), calibration(psi_rad=math.tau - 0.02))
    assert angle.change == pytest.approx(-0.03)
    held = SPREADS | {"source_frame": SPREADS["source_frame"] | {"source_distance_mm": None}}
    of_r = next(each for each in differences(calibration(), calibration(held)) if each.name == "source_distance_mm")
    assert (of_r.error, of_r.is_certain) == (None, None)
