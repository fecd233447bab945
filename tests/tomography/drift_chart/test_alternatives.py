"""Steps and trends of a history against least squares by hand and by a dense design matrix."""

import math

import numpy as np
import pytest

from sawmill_tomography.drift.chart.alternatives import steps_and_trends
from sawmill_tomography.drift.chart.chart import History
from sawmill_tomography.drift.chart.spread import BELIEVED, LookSpread

NOTHING = np.zeros((2, 2))
NOISE = np.random.default_rng(4)


def scattering(*ratio):
    """As an endless history has shown."""
    return LookSpread(10**12, 1e12 * np.diag(ratio), np.zeros(2), np.eye(2))


NO_SCATTER = scattering(1.0, 1.0)


def history_of(days, means, covariance):
    scatter = LookSpread.of_looks(means[:1], covariance[:1])
    history = History.starting_with([(np.asarray(days[0]), means[0], covariance[0])], scatter)
    for each in zip(days[1:], means[1:], covariance[1:], strict=True):
        history = history.followed_by(np.asarray(each[0]), *each[1:])
    return history


def dense(days, means, covariance, shape):
    """Twice the log-likelihood ratio, change and its covariance, of shape(days) times a constant (2,) added."""
    size = len(days)
    weight = np.zeros((2 * size, 2 * size))
    for k in range(size):
        weight[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.linalg.inv(covariance[k])
    constant = np.kron(np.ones((size, 1)), np.eye(2))
    design = np.hstack([constant, np.kron(shape[:, None], np.eye(2))])
    values = means.ravel()

    def fitted(of):
        normal = of.T @ weight @ of
        found = np.linalg.solve(normal, of.T @ weight @ values)
        rest = values - of @ found
        return found, np.linalg.inv(normal), rest @ weight @ rest

    _, _, without = fitted(constant)
    found, spread, with_change = fitted(design)
    return without - with_change, found[2:], spread[2:, 2:]


def test_evidence_counts_less_in_the_direction_in_which_looks_scatter_more():
    """Independent u_c and tau; u_c scatters four times as much in variance, tau as it says."""
    means, spread = NOISE.standard_normal((12, 2)), np.tile(np.diag([1.0, 9.0]), (12, 1, 1))
    history = history_of(np.arange(12.0), means, spread)
    believed, _ = steps_and_trends(history.segments, NO_SCATTER, NOTHING)
    doubted, _ = steps_and_trends(history.segments, scattering(4.0, 1.0), NOTHING)
    parts = believed.change**2 / np.diagonal(believed.covariance, axis1=-2, axis2=-1)
    np.testing.assert_allclose(doubted.evidence, parts @ [0.25, 1.0], rtol=1e-5)
    np.testing.assert_allclose(doubted.covariance[0], believed.covariance[0] * np.diag([4.0, 1.0]), rtol=1e-6)


def test_scatter_is_found_by_direction_and_moved_by_neither_jump_nor_trend():
    """What u_c does not explain of tau scatters three times as far as it should."""
    size, spread = 800, np.array([[4.0, 1.0], [1.0, 0.5]])
    root = np.linalg.cholesky(spread)
    errors = NOISE.standard_normal((size, 2)) * [0.8, 3.0] @ root.T
    covariance = np.tile(spread, (size, 1, 1))
    ratio = LookSpread.of_looks(errors, covariance).ratio
    np.testing.assert_allclose(ratio, np.diag([1.0, 9.0]), atol=1.2)
    jumping = errors + 100.0 * (np.arange(size) > 400)[:, None]
    sliding = errors + 0.02 * np.arange(size)[:, None]
    for moved in (jumping, sliding):
        np.testing.assert_allclose(LookSpread.of_looks(moved, covariance).ratio, ratio, atol=0.2)


def test_evidence_by_a_scatter_that_few_looks_have_shown_is_as_rare_as_it_says():
    """Normal means against a covariance that is estimated from 30 of them; SHARED makes successive ones 20."""
    rng, size, shown = np.random.default_rng(5), 40_000, 30
    freedom = 20
    estimated = rng.standard_normal((size, freedom, 2))
    precision = np.linalg.inv(np.swapaxes(estimated, -1, -2) @ estimated / freedom)
    apart = rng.standard_normal((size, 2))
    distance = np.einsum("ki,kij,kj->k", apart, precision, apart)
    evidence = LookSpread(shown - BELIEVED, np.eye(2), np.zeros(2), np.eye(2)).chi_squared(distance)
    for limit in (4.0, 8.0, 12.0):
        assert np.mean(evidence > limit) == pytest.approx(math.exp(-0.5 * limit), rel=0.25)
