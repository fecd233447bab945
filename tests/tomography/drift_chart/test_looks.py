"""Looks pooled with their covariances, and set against a baseline."""

import math

import numpy as np
import pytest

from sawmill_tomography.drift.chart.looks import BASELINE_LOOKS, Baseline, DriftCheckPoint, pooled
from sawmill_vocabulary import DetectorEstimate

# Of one look, 20 views of 100 rows: 0.04 mm and 0.09 degrees with both free, 0.005 mm along what it sees.
ALONG, TILT = 0.005, math.radians(0.09)
LOOK = np.array([[(25.0 * TILT) ** 2 + ALONG**2, -25.0 * TILT**2], [-25.0 * TILT**2, TILT**2]])


def looks(errors, covariance=LOOK, truth=(0.0, 0.0)):
    root = np.linalg.cholesky(covariance)
    changes = [DetectorEstimate.of(np.add(truth, root @ error), covariance) for error in errors]
    return [DriftCheckPoint(k / 2000.0, change) for k, change in enumerate(changes)]


def test_two_looks_weigh_by_their_own_covariances():
    first = DriftCheckPoint(1.0, DetectorEstimate.of([1.0, 0.0], np.diag([1.0, 4.0])))
    second = DriftCheckPoint(3.0, DetectorEstimate.of([2.0, 5.0], np.diag([4.0, 1.0])))
    both = pooled([first, second])
    np.testing.assert_allclose(both.change.values, [(1.0 + 2.0 / 4.0) / 1.25, 5.0 / 1.25])
    np.testing.assert_allclose(both.change.covariance, np.eye(2) / 1.25)
    assert (both.days, both.looks, both.outliers) == (2.0, 2, 0)


def test_logs_that_differ_tell_the_tilt_that_neither_sees():
    """One sees u + 10 tau, the other u - 10 tau, each to 0.01 and nothing else: together u and tau."""

    def seeing(sign, value):
        direction = np.array([1.0, sign * 10.0])
        covariance = np.linalg.inv(np.outer(direction, direction) * 1e4 + np.eye(2) * 1e-6)
        return DriftCheckPoint(0.0, DetectorEstimate.of([value, 0.0], covariance))

    both = pooled([seeing(+1.0, 0.02), seeing(-1.0, -0.01)])
    np.testing.assert_allclose(both.change.values, [0.005, 0.0015], rtol=1e-6)
    np.testing.assert_allclose(both.change.deviations, [0.01 / math.sqrt(2.0), 0.001 / math.sqrt(2.0)], rtol=1e-6)


def test_fifty_looks_know_u_c_to_a_fiftieth_of_a_millimetre_as_they_say():
    errors = np.random.default_rng(1).standard_normal((100, 50, 2))
    many = [pooled(looks(each)) for each in errors]
    found = np.array([each.change.values for each in many])
    assert many[0].change.deviations[0] < 0.02 / 3.0
    chi_squared = np.einsum("ki,ij,kj->k", found, np.linalg.inv(many[0].change.covariance), found)
    assert np.mean(chi_squared) == pytest.approx(2.0, abs=0.6)  # its standard deviation is 0.2


@pytest.mark.parametrize("number", [1, 4])
def test_outliers_are_left_out_and_counted(number):
    errors = np.random.default_rng(2).standard_normal((10, 2))
    clean = pooled(looks(errors[number:]))
    errors[:number] = [30.0, -8.0]
    outlying = pooled(looks(errors))
    assert (outlying.looks, outlying.outliers) == (10, number)
    np.testing.assert_allclose(outlying.change.values, clean.change.values, atol=1e-6)


def test_a_baseline_cancels_what_stays_and_adds_its_own_error():
    stays = np.array([0.15, 0.002])
    errors = np.random.default_rng(3).standard_normal((BASELINE_LOOKS, 2))
    baseline = Baseline.of(looks(errors, truth=stays))
    zero = baseline.estimate.change
    np.testing.assert_allclose(LOOK + zero.covariance, LOOK * (1.0 + 1.0 / BASELINE_LOOKS), rtol=0.02)
    assert abs(stays[0] - zero.cor_column_mm) < 3.0 * zero.deviations[0]
    assert baseline.until_days == pytest.approx(49 / 2000)


def test_wrong_input_gets_a_sentence():
    with pytest.raises(ValueError, match=r"symmetric and positive definite, not \(\(1.0, 2.0\)"):
        DriftCheckPoint(0.0, DetectorEstimate.of([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]]))
    with pytest.raises(ValueError, match="finite values, not nan"):
        DriftCheckPoint(math.nan, DetectorEstimate.of([0.0, 0.0], LOOK))
    with pytest.raises(ValueError, match="2 values with a covariance of 2 x 2 values: too many"):
        DetectorEstimate.of([0.0, 0.0, 0.0], LOOK)
    with pytest.raises(ValueError, match="2 looks make no baseline: 3"):
        Baseline.of(looks(np.zeros((2, 2))))
    with pytest.raises(ValueError, match="0 looks"):
        pooled([])
