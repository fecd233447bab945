"""The study of run lengths draws errors of the size that scanners have, and counts alarms as charts give them."""

import numpy as np
import pytest
from run_lengths import LIMITS, Change, Errors, false_alarms, found

from sawmill_tomography.drift.chart.chart import DriftKind

COVARIANCE = np.array([[4e-4, -1.4e-5], [-1.4e-5, 5e-7]])


@pytest.fixture
def errors(tmp_path):
    """Two scanners, whose errors are as large and twice as large as their covariances say, beside one that stays."""
    rng = np.random.default_rng(1)
    root = np.linalg.cholesky(COVARIANCE)
    white = rng.standard_normal((400, 2)) * np.repeat([1.0, 2.0], 200)[:, None]
    table = {
        "mill": np.repeat([0.0, 1.0], 200),
        "error": [0.5, 0.02] + white @ root.T,
        "covariance": np.tile(COVARIANCE, (400, 1, 1)),
    }
    np.savez(tmp_path / "errors.npz", **table)
    return Errors.read(tmp_path / "errors.npz")


def test_errors_are_drawn_as_they_scatter_and_without_what_stays(errors):
    scanner = np.repeat([0, 1], 2000)
    drawn, covariance = errors.drawn(np.random.default_rng(2), scanner, 5)
    np.testing.assert_allclose(covariance[0, 0], COVARIANCE)
    for at, variance in ((0, 1.0), (1, 4.0)):
        of_one = drawn[scanner == at].reshape(-1, 2)
        np.testing.assert_allclose(np.cov(of_one.T), variance * COVARIANCE, rtol=0.25)
        assert np.all(np.abs(of_one.mean(axis=0)) < 0.05 * np.sqrt(variance * np.diag(COVARIANCE)))


def test_alarms_are_rarer_at_higher_limits_and_years_run_until_them(errors):
    alarms, years = false_alarms(errors, 40, 0.25, np.random.default_rng(3))
    assert np.all(np.diff(alarms, axis=1) <= 0.0)
    assert np.all(alarms[1] <= alarms[0])
    assert np.all(np.diff(years, axis=1) >= 0.0)
    assert years.max() <= 40 * 0.25 / 365.0 + 1e-12
    assert alarms[0, LIMITS.searchsorted(30.0)] <= 1


def test_every_jump_is_found_with_its_time_and_size(errors):
    jump = Change("jump", DriftKind.JUMP, 0.2, at=np.full(10, 0.2))
    findings, early = found(errors, jump, np.random.default_rng(4))
    assert (len(findings), early) == (10, 0)
    for each in findings:
        assert 0 < each.looks <= 40
        assert each.finding.kind is DriftKind.JUMP
        assert each.finding.between_days[0] <= 0.2035
        assert each.finding.between_days[1] >= 0.2
        assert each.finding.change.cor_column_mm == pytest.approx(0.2, abs=0.06)
