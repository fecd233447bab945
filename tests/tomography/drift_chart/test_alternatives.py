"""Steps and trends of a history against least squares by hand and by a dense design matrix."""

import math

import numpy as np
import pytest

from sawmill_tomography.drift.chart.alternatives import FEWEST_OF_A_TREND, steps_and_trends
from sawmill_tomography.drift.chart.history import History
from sawmill_tomography.drift.chart.segments import OF_EACH_SIZE
from sawmill_tomography.drift.chart.spread import BELIEVED, LookSpread

NOTHING = np.zeros((2, 2))
NOISE = np.random.default_rng(4)


def scattering(*ratio):
    """As an endless history has shown."""
    return LookSpread(10**12, 1e12 * np.diag(ratio), np.zeros(2), np.eye(2))


NO_SCATTER = scattering(1.0, 1.0)


def covariances(number):
    """Different, strongly correlated ones."""
    root = NOISE.standard_normal((number, 2, 2)) @ np.diag([1.0, 1e-3]) + [[0.3, 0.0], [0.0, 1e-3]]
    return root @ root.transpose(0, 2, 1)


def history_of(days, means, covariance):
    scatter = LookSpread.of_looks(means[:1], covariance[:1])
    history = History.starting_with([(np.asarray(days[0]), means[0], covariance[0])], scatter)
    for each in zip(days[1:], means[1:], covariance[1:], strict=True):
        history = history.followed_by(np.asarray(each[0]), *each[1:])
    return history


def test_one_group_after_the_baseline_by_hand():
    """The covariances add: 1 of the baseline, 3 of the group; and what logs may do, 5."""
    history = history_of([0.0, 1.0], np.array([[1.0, 0.0], [4.0, 0.0]]), np.array([np.eye(2), 3.0 * np.eye(2)]))
    steps, trends = steps_and_trends(history.segments, NO_SCATTER, 5.0 * np.eye(2))
    np.testing.assert_allclose(steps.change, [[3.0, 0.0]])
    np.testing.assert_allclose(steps.covariance, [9.0 * np.eye(2)], atol=1e-6)
    assert steps.likelihood == pytest.approx(9.0 / 4.0)
    assert steps.evidence == pytest.approx(9.0 / 9.0)
    assert trends.evidence == pytest.approx(0.0)  # one group is no trend


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


def test_both_models_are_generalised_least_squares_with_the_mean_unknown():
    """Against the dense fit, at every candidate, on groups with different covariances and uneven times."""
    size = FEWEST_OF_A_TREND + 4
    days = 300.0 + np.cumsum(NOISE.uniform(0.001, 0.02, size))
    covariance = covariances(size)
    means = NOISE.standard_normal((size, 2)) * [1.0, 1e-3]
    history = history_of(days, means, covariance)
    steps, trends = steps_and_trends(history.segments, NO_SCATTER, NOTHING)
    # The oldest two single groups have been joined twice.
    ends = steps.began_days
    assert len(ends) < size - 1
    for k, began in enumerate(ends):
        for model, shape in ((steps, days > began), (trends, np.maximum(days - began, 0.0))):
            if model is trends and np.count_nonzero(days > began) < FEWEST_OF_A_TREND:
                assert model.evidence[k] == 0.0
                continue
            likelihood, change, spread = dense(days, means, covariance, shape.astype(float))
            assert model.likelihood[k] == pytest.approx(likelihood, rel=1e-5)
            np.testing.assert_allclose(model.change[k], change, rtol=1e-5)
            np.testing.assert_allclose(model.covariance[k], spread, rtol=1e-5)
            assert model.evidence[k] == pytest.approx(model.likelihood[k], rel=1e-4)


def test_evidence_counts_less_in_the_direction_in_which_looks_scatter_more():
    """Independent u_c and tau; u_c scatters four times as much in variance, tau as it says."""
    means, spread = NOISE.standard_normal((12, 2)), np.tile(np.diag([1.0, 9.0]), (12, 1, 1))
    history = history_of(np.arange(12.0), means, spread)
    believed, _ = steps_and_trends(history.segments, NO_SCATTER, NOTHING)
    doubted, _ = steps_and_trends(history.segments, scattering(4.0, 1.0), NOTHING)
    parts = believed.change**2 / np.diagonal(believed.covariance, axis1=-2, axis2=-1)
    np.testing.assert_allclose(doubted.evidence, parts @ [0.25, 1.0], rtol=1e-5)
    np.testing.assert_allclose(doubted.covariance[0], believed.covariance[0] * np.diag([4.0, 1.0]), rtol=1e-6)


def test_a_long_history_keeps_few_segments_and_all_of_its_sums():
    size = 500
    history = history_of(np.arange(float(size)), NOISE.standard_normal((size, 2)), np.tile(np.eye(2), (size, 1, 1)))
    groups = [segment.groups for segment in history.segments]
    assert sum(groups) == size
    assert groups == sorted(groups, reverse=True)
    assert max(groups.count(each) for each in set(groups)) <= OF_EACH_SIZE
    assert len(groups) <= OF_EACH_SIZE * 7
    # Any change point is near a candidate: within half a segment, which is a sixteenth of its age.
    ages = size - 1 - history.alternatives(NOTHING)[0].began_days
    assert np.all(-np.diff(ages) <= (ages[:-1] + OF_EACH_SIZE - 1) / OF_EACH_SIZE)


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
