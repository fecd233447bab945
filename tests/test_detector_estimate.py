"""The value of u_c and tau with their errors, which fits, charts, rules and rows share."""

import math

import numpy as np
import pytest

from sawmill_vocabulary import DetectorEstimate


def test_an_estimate_is_a_value_whatever_its_numbers_came_in():
    plain = DetectorEstimate(0.1, 0.002, ((0.25, 0.1), (0.1, 0.16)))
    assert DetectorEstimate.of(np.array([0.1, 0.002]), np.array(plain.covariance)) == plain
    assert DetectorEstimate.of([0.1, 0.002], [[0.25, 0.1], [0.1, 0.16]]) == plain
    assert (plain.values, plain.deviations) == ((0.1, 0.002), (0.5, 0.4))
    with pytest.raises(ValueError, match="2 values with a covariance of 2 x 2"):
        DetectorEstimate.of([0.1, 0.002], np.eye(3))


@pytest.mark.parametrize(
    ("covariance", "relative"),
    [
        (((4.0, 0.0), (0.0, 1e-6)), 1.0),
        (((4.0, 1.2), (1.2, 1.0)), 0.64),
        (((1.0, 1.0), (1.0, 1.0)), 0.0),
        (((1.0, 2.0), (2.0, 1.0)), -3.0),
        (((0.0, 0.0), (0.0, 1.0)), 0.0),
        (((-1.0, 0.0), (0.0, -1.0)), 0.0),
        (((math.inf, 0.0), (0.0, 1.0)), 0.0),
        (((1.0, math.nan), (math.nan, 1.0)), 0.0),
    ],
)
def test_a_covariance_without_an_inverse_has_no_positive_determinant(covariance, relative):
    assert DetectorEstimate(0.1, 0.002, covariance).relative_determinant == pytest.approx(relative)
