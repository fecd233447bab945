"""Calibrations of one scanner against each other."""

from dataclasses import replace

import numpy as np
import pytest

from sawmill_calibration.calibration.repeatability import repeatability
from sawmill_contracts.calibrations import PredictedRayError
from sawmill_platform.contracts.attempts import JobFailure

# Standard deviations of psi, R, SDD, u_c and tau, rad and mm.
COVARIANCE = (np.diag([1e-4, 0.5, 0.8, 0.02, 5e-4]) ** 2).tolist()
PREDICTED = PredictedRayError(rms=0.02, max=0.04, upper_95=0.03, radius_mm=150.0)


@pytest.fixture
def result(calibration, theta):
    """A calibration whose R, as a share, and u_c are off by so much."""

    def of(longer=0.0, column_mm=0.0, covariance=COVARIANCE):
        frame = theta.source_frame(859.46)
        off = replace(
            frame,
            source_distance_mm=frame.source_distance_mm * (1.0 + longer),
            cor_column_mm=frame.cor_column_mm + column_mm,
        )
        return calibration(source_frame=off, covariance=covariance, predicted_ray_error_mm=PREDICTED)

    return of


def test_two_that_differ_by_their_noise_are_repeatable(result):
    found = repeatability([("a", result()), ("b", result(column_mm=0.01)), ("c", result(column_mm=-0.01))])
    assert found.verdict == "repeatable"
    assert [(pair.first, pair.second) for pair in found.pairs] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert found.pairs[0].cor_column_difference_mm == pytest.approx(0.01)
    assert found.pairs[0].cor_column_deviation_mm == pytest.approx(0.02 * np.sqrt(2.0))


def test_a_moved_centre_and_a_changed_scale_are_each_beyond_the_error_bars(result):
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
