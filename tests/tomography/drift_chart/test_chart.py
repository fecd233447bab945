"""The chart as its user feeds it, look by look; looks pooled with their covariances, and set against a baseline."""

import json
import math

import numpy as np
import pytest

from sawmill_tomography.drift.chart.chart import (
    GROUP_LOOKS,
    LIMIT,
    QUIET,
    DriftChart,
    DriftKind,
    History,
    chart_from_state,
    chart_to_state,
)
from sawmill_tomography.drift.chart.looks import BASELINE_LOOKS, BELIEVED, Baseline, DriftCheckPoint, LookSpread, pooled
from sawmill_tomography.drift.chart.segments import steps_and_trends
from sawmill_vocabulary import DetectorEstimate

# Of one look, 20 views of 100 rows: 0.04 mm and 0.09 degrees with both free, 0.005 mm along what it sees.
ALONG, TILT = 0.005, math.radians(0.09)
LOOK = np.array([[(25.0 * TILT) ** 2 + ALONG**2, -25.0 * TILT**2], [-25.0 * TILT**2, TILT**2]])
# What a look knows to ALONG.
SEEN = np.array([1.0, 25.0])
A_DAY = 2000


def looks(seed, number, moved=lambda _days: 0.0, *, outliers=0.01, larger=1.0):
    """A day has 2 000; each has its own covariance, and some have an error of fifteen standard deviations and more."""
    rng = np.random.default_rng(seed)
    for k in range(number):
        covariance = LOOK * rng.uniform(0.5, 4.0)
        error = larger * np.linalg.cholesky(covariance) @ rng.standard_normal(2)
        if rng.random() < outliers:
            error *= 15.0
        change = 0.3 + moved(k / A_DAY) + error[0], 0.01 + error[1]
        yield DriftCheckPoint(k / A_DAY, DetectorEstimate.of(change, covariance))


def charted(given, chart=None):
    chart = chart or DriftChart()
    for look in given:
        chart = chart.with_look(look)
        if not chart.pending and chart.finding().alarm:
            break
    return chart


def test_it_learns_first_and_is_quiet_then():
    given = list(looks(1, 200))
    learning = charted(given[: BASELINE_LOOKS - 1])
    assert learning.baseline is None
    assert learning.finding().kind is DriftKind.LEARNING
    quiet = charted(given[BASELINE_LOOKS - 1 :], learning)
    assert quiet.baseline.estimate.looks == BASELINE_LOOKS
    assert quiet.finding().kind is DriftKind.QUIET
    assert 0.0 < quiet.finding().evidence < LIMIT


@pytest.mark.parametrize("size_mm", [0.03, 0.2, -5.0])
def test_a_jump_is_found_with_its_size_and_time(size_mm):
    found = charted(looks(2, 200, lambda days: size_mm * (days > 0.0613))).finding()
    assert found.kind is DriftKind.JUMP
    assert found.between_days[0] <= 0.0613 <= found.between_days[1] < 0.08
    assert found.between_days[0] > 0.04
    assert abs(found.change.cor_column_mm - size_mm) < 3.0 * found.change.deviations[0]
    assert found.log_odds > 0.0


@pytest.mark.parametrize(("size_mm", "before"), [(0.05, 0), (0.05, 4), (-0.3, 5), (0.05, 7)])
def test_a_jump_in_the_midst_of_ten_looks_has_its_size_from_the_first_alarm_on(size_mm, before):
    chart, found = DriftChart(), []
    at = (BASELINE_LOOKS + before - 0.5) / A_DAY
    for look in looks(12, BASELINE_LOOKS + 3 * GROUP_LOOKS, lambda days: size_mm * (days > at), outliers=0.0):
        chart = chart.with_look(look)
        if not chart.pending and chart.finding().alarm:
            found.append(chart.finding())
    assert len(found) >= 2
    for each in found:
        assert each.kind is DriftKind.JUMP
        assert each.between_days[0] <= at <= each.between_days[1]
        assert abs(SEEN @ each.change.values - size_mm) < 2.5 * math.sqrt(SEEN @ each.change.covariance @ SEEN) < 0.02


@pytest.mark.parametrize("before", [8, 15, 20, 27, 40])
def test_a_jump_among_the_first_looks_is_none_of_zero(before):
    """Zero is what was before it, and the alarm comes with the fiftieth look or soon after."""
    at = (before - 0.5) / A_DAY
    chart = charted(looks(13, 80, lambda days: 0.06 * (days > at), outliers=0.0))
    found = chart.finding()
    assert found.kind is DriftKind.JUMP
    assert found.between_days[0] <= at <= found.between_days[1]
    assert abs(SEEN @ found.change.values - 0.06) < 2.5 * math.sqrt(SEEN @ found.change.covariance @ SEEN) < 0.02
    assert SEEN @ chart.baseline.estimate.change.values == pytest.approx(0.3 + 25.0 * 0.01, abs=0.01)
    assert chart.baseline.estimate.looks - chart.baseline.estimate.outliers <= before


def test_a_trend_is_found_with_its_slope_and_time():
    found = charted(looks(3, 1200, lambda days: 0.2 * max(days - 0.1, 0.0))).finding()
    assert found.kind is DriftKind.TREND
    assert found.between_days[0] <= 0.1 <= found.between_days[1]
    assert abs(found.change.cor_column_mm - 0.2) < 3.0 * found.change.deviations[0]
    assert found.log_odds > math.log(100.0)


def test_a_jump_stays_a_jump_hours_later():
    chart = DriftChart()
    # The candidates near the jump have been joined by then.
    for look in looks(4, 400, lambda days: 0.2 * (days > 0.0513)):
        chart = chart.with_look(look)
    found = chart.finding()
    assert found.kind is DriftKind.JUMP
    assert found.began_days == pytest.approx(0.0513, abs=0.02)
    assert found.change.cor_column_mm == pytest.approx(0.2, abs=0.02)


def test_outliers_and_covariances_that_are_too_small_raise_no_alarm():
    assert charted(looks(5, 200, outliers=0.05)).finding().kind is DriftKind.QUIET
    found = charted(looks(6, 300, larger=1.5)).finding()
    assert found.kind is DriftKind.QUIET
    assert found.scatter == pytest.approx(1.5, rel=0.2)


def test_quiet_scanners_stay_quiet_and_evidence_comes_near_the_limit():
    """150 scanners with 2 000 looks each, 0.4 of a year."""
    rng = np.random.default_rng(7)
    scanners = 150
    root, group = np.linalg.cholesky(LOOK), np.tile(LOOK / 10.0, (scanners, 1, 1))
    zero = rng.standard_normal((scanners, 2)) @ root.T / math.sqrt(50.0)
    scatter = LookSpread.of_looks(zero[:, None], 10.0 * group[:, None])
    history = History.starting_with([(np.zeros(scanners), zero, group / 5.0)], scatter)
    largest = np.zeros(scanners)
    for k in range(1, 201):
        mean = rng.standard_normal((scanners, 2)) @ root.T / math.sqrt(10.0)
        history = history.followed_by(np.full(scanners, k / 200.0), mean, group)
        if k % 5 == 0:
            largest = np.maximum(
                largest, np.max([each.likelihood.max(axis=0) for each in history.alternatives(QUIET)], axis=0)
            )
    assert np.count_nonzero(largest > LIMIT) <= 3
    assert np.median(largest) > 8.0
    for model in history.alternatives(QUIET):
        assert np.all(model.evidence < model.likelihood + 1e-9)


def test_json_keeps_a_chart_and_goes_on_as_if_it_had_not_been_put_away():
    given = list(looks(8, 250, lambda days: 0.05 * (days > 0.1)))
    straight, put_away = DriftChart(), DriftChart()
    for k, look in enumerate(given):
        straight = straight.with_look(look)
        if k % 37 == 0 or k == BASELINE_LOOKS:
            put_away = chart_from_state(json.loads(json.dumps(chart_to_state(put_away))))
        put_away = put_away.with_look(look)
    assert chart_to_state(put_away) == chart_to_state(straight)
    assert len(json.dumps(chart_to_state(straight))) < 20_000
    assert straight.finding().kind is DriftKind.JUMP


def test_a_state_that_is_none_is_refused():
    state = chart_to_state(DriftChart())
    with pytest.raises(ValueError, match="layout is 2 and must be 3"):
        chart_from_state({**state, "layout": 2})
    with pytest.raises(ValueError, match="no state of a drift chart: 'pending'"):
        chart_from_state({name: value for name, value in state.items() if name != "pending"})


@pytest.mark.parametrize(
    ("place", "wrong"),
    [
        (("pending",), [[1.0]]),
        (("pending",), "none"),
        (("baseline",), None),
        (("baseline", "estimate", "change"), [0.0]),
        (("history",), []),
        (("history", "segments", 0, "precision"), [1.0]),
        (("history", "segments"), []),
        (("history", "segments", 0, "first_days"), None),
        (("newest",), []),
        (("history", "scatter", "differences"), "many"),
        (("history", "scatter", "squares"), [[math.nan, 0.0], [0.0, 1.0]]),
    ],
)
def test_a_damaged_state_is_refused_before_a_look_is_added(place, wrong):
    chart = DriftChart()
    for look in looks(9, BASELINE_LOOKS + 10):
        chart = chart.with_look(look)
    inner = state = chart_to_state(chart)
    for name in place[:-1]:
        inner = inner[name]
    inner[place[-1]] = wrong
    with pytest.raises(ValueError, match=r"drift chart|could not convert|inhomogeneous"):
        chart_from_state(state)


def looks_of(errors, covariance=LOOK, truth=(0.0, 0.0)):
    root = np.linalg.cholesky(covariance)
    changes = [DetectorEstimate.of(np.add(truth, root @ error), covariance) for error in errors]
    return [DriftCheckPoint(k / 2000.0, change) for k, change in enumerate(changes)]


def test_two_looks_weigh_by_their_own_covariances():
    first = DriftCheckPoint(1.0, DetectorEstimate.of([1.0, 0.0], np.diag([1.0, 4.0])))
    both = pooled([first, DriftCheckPoint(3.0, DetectorEstimate.of([2.0, 5.0], np.diag([4.0, 1.0])))])
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
    many = [pooled(looks_of(each)) for each in np.random.default_rng(1).standard_normal((100, 50, 2))]
    found = np.array([each.change.values for each in many])
    assert many[0].change.deviations[0] < 0.02 / 3.0
    chi_squared = np.einsum("ki,ij,kj->k", found, np.linalg.inv(many[0].change.covariance), found)
    assert np.mean(chi_squared) == pytest.approx(2.0, abs=0.6)  # its standard deviation is 0.2


@pytest.mark.parametrize("number", [1, 4])
def test_outliers_are_left_out_and_counted(number):
    errors = np.random.default_rng(2).standard_normal((10, 2))
    clean = pooled(looks_of(errors[number:]))
    errors[:number] = [30.0, -8.0]
    outlying = pooled(looks_of(errors))
    assert (outlying.looks, outlying.outliers) == (10, number)
    np.testing.assert_allclose(outlying.change.values, clean.change.values, atol=1e-6)


def test_a_baseline_cancels_what_stays_and_adds_its_own_error():
    stays = np.array([0.15, 0.002])
    baseline = Baseline.of(looks_of(np.random.default_rng(3).standard_normal((BASELINE_LOOKS, 2)), truth=stays))
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
        Baseline.of(looks_of(np.zeros((2, 2))))
    with pytest.raises(ValueError, match="0 looks"):
        pooled([])


NOTHING = np.zeros((2, 2))
NOISE = np.random.default_rng(4)


def scattering(*ratio):
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
    values = means.ravel()

    def fitted(of):
        normal = of.T @ weight @ of
        found = np.linalg.solve(normal, of.T @ weight @ values)
        rest = values - of @ found
        return found, np.linalg.inv(normal), rest @ weight @ rest

    _, _, without = fitted(constant)
    found, spread, with_change = fitted(np.hstack([constant, np.kron(shape[:, None], np.eye(2))]))
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
    errors = NOISE.standard_normal((size, 2)) * [0.8, 3.0] @ np.linalg.cholesky(spread).T
    covariance = np.tile(spread, (size, 1, 1))
    ratio = LookSpread.of_looks(errors, covariance).ratio
    np.testing.assert_allclose(ratio, np.diag([1.0, 9.0]), atol=1.2)
    sliding = errors + 0.02 * np.arange(size)[:, None]
    for moved in (errors + 100.0 * (np.arange(size) > 400)[:, None], sliding):
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
