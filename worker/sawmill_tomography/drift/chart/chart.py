"""The control chart of one scanner from its history since its calibration: quiet, a jump, or a slow trend.

A generalised likelihood ratio chart over change points and two models of change. Its input is robustly pooled groups of
drift checks (docs/understand/drift.md). JSON keeps a chart as numbers, lists and dictionaries, without loss.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from sawmill_tomography.drift.chart.looks import (
    BASELINE_LOOKS,
    FEWEST_BASELINE_LOOKS,
    OUTLYING,
    Baseline,
    DriftCheckPoint,
    LookSpread,
    PooledDriftCheckPoint,
    inverse,
    pooled,
    pooled_means,
    scaled,
    squared_length,
    stacked,
    times,
)
from sawmill_tomography.drift.chart.segments import Segment, StepAndTrendFits, extended, steps_and_trends
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DetectorEstimate

# One pooled group: its last time (...) in days, mean (..., 2) and covariance (..., 2, 2).
Group = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class History:
    """The groups of drift checks in segments, and the scatter of checks and groups."""

    segments: tuple[Segment, ...]  # oldest first
    scatter: LookSpread

    @classmethod
    def starting_with(cls, groups: Iterable[Group], scatter: LookSpread) -> "History":
        """Return the history of a baseline's groups, oldest first, with the scatter of the baseline's drift checks."""
        return cls(reduce(extended, (_segment(*group) for group in groups), ()), scatter)

    def followed_by(self, days: FloatArray, mean: FloatArray, covariance: FloatArray) -> "History":
        """Return the history with one more `Group`."""
        newest = _segment(days, mean, covariance)
        return History(extended(self.segments, newest), self.scatter.followed_by(mean, covariance))

    def alternatives(self, quiet: FloatArray) -> tuple[StepAndTrendFits, StepAndTrendFits]:
        """Fit steps and trends to the segments (`steps_and_trends`)."""
        return steps_and_trends(self.segments, self.scatter, quiet)


def _segment(days: FloatArray, mean: FloatArray, covariance: FloatArray) -> Segment:
    return Segment.of_group(days, mean, inverse(covariance))


# Drift checks pooled in one group: 7 minutes of a day of 2 000 logs, and four outliers of ten do no harm.
GROUP_LOOKS = 10
# Evidence above this is an alarm. Simulated: benchmarks/run_lengths.py of commit db71b07a, docs/understand/drift.md.
LIMIT = 30.0
# Standard deviations of u_c (mm) and tau (rad) between times at which other logs are sawn on an unchanged scanner.
QUIET_DEVIATION = (0.002, 5e-5)
QUIET = np.diag(np.square(QUIET_DEVIATION))
# Candidates whose likelihood is within this of the best one's may be the time of change (chi-squared, 95 of 100).
PLAUSIBLE = 6.0


class DriftKind(StrEnum):
    """Kinds of a chart's finding."""

    LEARNING = "learning"
    QUIET = "quiet"
    JUMP = "jump"
    TREND = "trend"


@dataclass(frozen=True)
class ChartFinding:
    """Result of a chart: whether, when and by how much the geometry changed."""

    # Learning until the baseline is complete; the likelier of jump and trend where the evidence is above the limit
    kind: DriftKind
    evidence: float = 0.0  # chi-squared of the change with the most evidence, and the limit above which it is an alarm
    limit: float = LIMIT
    # Root mean square ratio of the drift checks' scatter to the scatter by their covariances; at least 1
    scatter: float = 1.0
    # For a jump or a trend: time of the last drift check before the change, in days since the calibration
    began_days: float | None = None
    between_days: tuple[float, float] | None = None  # (float, float) or None: interval of 95 % of that time
    change: DetectorEstimate | None = None  # the jump, or the trend in mm and rad a day
    log_odds: float = 0.0  # natural logarithm of the likelihood ratio of this kind of change to the other kind

    @property
    def alarm(self) -> bool:
        """True if a phantom scan is due."""
        return self.kind in {DriftKind.JUMP, DriftKind.TREND}


@dataclass(frozen=True, eq=False)
class DriftChart:
    """Summary of a scanner's drift checks since its calibration.

    A chart is a value: `with_look` gives the next one. `state.chart_to_state` converts a chart to values for JSON.
    """

    pending: tuple[DriftCheckPoint, ...] = ()  # drift checks that wait for their baseline or group to be complete
    baseline: Baseline | None = None  # None until the baseline is complete
    # History of the groups, including the baseline's; None until the baseline is complete
    history: History | None = None
    newest: tuple[DriftCheckPoint, ...] = ()  # drift checks of the newest group

    def with_look(self, look: DriftCheckPoint) -> "DriftChart":
        """Return the chart with one drift check more, in the order in which logs were scanned."""
        pending = (*self.pending, look)
        if self.history is None:
            return _begun(pending) if len(pending) == BASELINE_LOOKS else replace(self, pending=pending)
        if len(pending) < GROUP_LOOKS:
            return replace(self, pending=pending)
        return replace(self, pending=(), history=self.history.followed_by(*_group(pending)), newest=pending)

    def finding(self) -> ChartFinding:
        """Return the result of the complete groups."""
        if self.history is None:
            return ChartFinding(DriftKind.LEARNING)
        history, now_days = self.history, float(self.history.segments[-1].last_days)
        scatter = float(np.sqrt(0.5 * np.trace(history.scatter.ratio)))
        result = replace(likelier(*history.alternatives(QUIET), now_days), scatter=scatter)
        if result.kind is not DriftKind.JUMP or result.began_days is None or result.between_days is None:
            return result
        since, until = result.between_days
        jump = jump_at(result.began_days, history.segments, self.newest, history.scatter, QUIET)
        result = replace(result, change=jump.change)
        if not jump.looks_before:
            return result
        # The jump is within the newest group.
        last_before, last = self.newest[jump.looks_before - 1].days, self.newest[-1].days
        return replace(result, began_days=last_before, between_days=(since, max(until, last)))


def _begun(looks: tuple[DriftCheckPoint, ...]) -> DriftChart:
    """Return the chart of the baseline's drift checks; zero is their mean before a jump, if there is a jump."""
    groups = [looks[first : first + GROUP_LOOKS] for first in range(0, len(looks), GROUP_LOOKS)]
    history = History.starting_with(map(_group, groups), LookSpread.of_looks(*stacked(look.change for look in looks)))
    chart = DriftChart(history=history, newest=groups[-1])
    began_days = chart.finding().began_days
    zero = looks if began_days is None else [look for look in looks if look.days <= began_days]
    return replace(chart, baseline=Baseline.of(zero))


def _group(looks: tuple[DriftCheckPoint, ...]) -> Group:
    """Pool a group at the last drift check's time, so that a jump within it lies between two groups' times."""
    group = pooled(looks)
    return np.asarray(looks[-1].days), np.array(group.change.values), np.array(group.change.covariance)


def likelier(steps: StepAndTrendFits, trends: StepAndTrendFits, now_days: float) -> ChartFinding:
    """Return the finding from one scanner's fits of steps and trends.

    The largest evidence decides whether there was a change. The likelihood decides its kind and time, among candidates
    that have at least half that evidence: other candidates may be likely, but their change is too small to matter.
    """
    evidence = float(max(steps.evidence.max(), trends.evidence.max()))
    if evidence <= LIMIT:
        return ChartFinding(DriftKind.QUIET, evidence)
    models = (steps, trends)
    likelihoods = [np.where(each.evidence >= 0.5 * evidence, each.likelihood, 0.0) for each in models]
    best = [float(each.max()) for each in likelihoods]
    # One group after the change fits both equally well, but for rounding.
    of_kind = int(best[1] > best[0] + 1e-6 * evidence)
    model, likelihood = models[of_kind], likelihoods[of_kind]
    at = int(np.argmax(likelihood))
    plausible = np.flatnonzero(likelihood >= best[of_kind] - PLAUSIBLE)
    # A change between two candidates is fitted at the nearer one; before the first candidate there is the calibration.
    times = [0.0, *model.began_days.tolist(), now_days]
    return ChartFinding(
        (DriftKind.JUMP, DriftKind.TREND)[of_kind],
        evidence,
        began_days=float(model.began_days[at]),
        between_days=(times[plausible[0]], times[plausible[-1] + 2]),
        change=DetectorEstimate.of(model.change[at], model.covariance[at]),
        log_odds=0.5 * (best[of_kind] - best[1 - of_kind]),
    )


class Jump(NamedTuple):
    """Size of a jump, and the number of the newest drift checks before the jump.

    The likeliest time of a jump is the end of a group or a segment, but scanners move within a group. So neither side
    of that time counts for the size: later groups are compared with earlier ones. While there is only one group after
    the jump, its checks are compared one by one with all groups before, and each may be the first after the jump.
    """

    change: DetectorEstimate
    looks_before: int


def jump_at(
    began_days: float,
    segments: Sequence[Segment],
    newest: Sequence[DriftCheckPoint],
    scatter: LookSpread,
    quiet: FloatArray,
) -> Jump:
    """Measure the jump of one scanner at the end of a segment or soon after."""
    earlier = [segment for segment in segments if segment.last_days <= began_days]
    later = segments[len(earlier) :]
    mean, covariance = _mean(earlier[:-1] or earlier)
    if len(later) == 1:
        return _within(newest, mean, covariance, scatter, quiet)
    mean_later, covariance_later = _mean(later[1:])
    return Jump(DetectorEstimate.of(mean_later - mean, scaled(covariance + covariance_later, scatter.ratio) + quiet), 0)


def _within(
    looks: Sequence[DriftCheckPoint], mean: FloatArray, covariance: FloatArray, scatter: LookSpread, quiet: FloatArray
) -> Jump:
    """Average the jumps before each drift check, weighted by likelihood; outliers count as if at `OUTLYING`."""
    change, own = stacked(look.change for look in looks)
    precision = inverse(scaled(own, scatter.ratio))
    before = _bounded(change - mean, precision)
    unlikely, sizes, errors = [], [], []
    for first in range(len(looks) - FEWEST_BASELINE_LOOKS + 1):
        after = pooled_means(change[first:], own[first:])
        unlikely.append(before[:first].sum() + _bounded(change[first:] - after.mean, precision[first:]).sum())
        sizes.append(after.mean - mean)
        errors.append(scaled(inverse(after.precision) + covariance, scatter.ratio) + quiet)
    weights = np.exp(-0.5 * (np.array(unlikely) - min(unlikely)))
    weights /= weights.sum()
    size = weights @ np.stack(sizes)
    apart = np.stack(sizes) - size
    spread = np.einsum("k,kij->ij", weights, np.stack(errors) + apart[:, :, None] * apart[:, None, :])
    return Jump(DetectorEstimate.of(size, spread), int(np.argmin(unlikely)))


def _mean(segments: Sequence[Segment]) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the segments' groups, and its covariance by the drift checks' own covariances."""
    covariance = inverse(np.sum([segment.precision[0] for segment in segments], axis=0))
    return times(covariance, np.sum([segment.weighted[0] for segment in segments], axis=0)), covariance


def _bounded(apart: FloatArray, precision: FloatArray) -> FloatArray:
    """Return chi-squared of each drift check; an outlier's is bounded."""
    return np.minimum(squared_length(apart, precision), OUTLYING**2)


# Version of the layout below: a chart of another layout is built again from the drift checks.
LAYOUT = 3


def chart_to_state(chart: DriftChart) -> dict[str, Any]:
    """Convert a chart for `chart_from_state`: some kilobytes, growing with the logarithm of the number of checks."""
    return {"layout": LAYOUT, **_as_json(asdict(chart))}


def _as_json(value: Any) -> Any:  # noqa: ANN401 - any field's
    """Convert arrays and tuples to lists, also within dictionaries."""
    if isinstance(value, dict):
        return {name: _as_json(each) for name, each in value.items()}
    if isinstance(value, tuple):
        return [_as_json(each) for each in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def chart_from_state(state: Mapping[str, Any]) -> DriftChart:
    """Return the chart from its state.

    Raises
    ------
    ValueError
        If the state has another layout, or is no state of a chart.
    """
    try:
        if state["layout"] != LAYOUT:
            raise ValueError(
                f"the drift chart's layout is {state['layout']!r} and must be {LAYOUT}: begin it anew from the looks"
            )
        baseline, history = state["baseline"], state["history"]
        if (baseline is None) != (history is None):
            raise ValueError("a drift chart has a baseline and a history, or neither")
        if history is not None and (not history["segments"] or len(state["newest"]) != GROUP_LOOKS):
            raise ValueError("a drift chart with a history has segments, and the looks of its newest group")
        return DriftChart(
            tuple(DriftCheckPoint(**_look(look)) for look in state["pending"]),
            None if baseline is None else _baseline(baseline),
            None if history is None else _history(history),
            tuple(DriftCheckPoint(**_look(look)) for look in state["newest"]),
        )
    except (KeyError, TypeError, AttributeError) as wrong:
        raise ValueError(f"this is no state of a drift chart: {wrong}") from wrong


def _numbers(value: object, *shape: int) -> FloatArray:
    numbers = np.asarray(value, np.float64)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise ValueError(f"a drift chart has finite numbers of the shape {shape} here, not {value!r}")
    return numbers


def _look(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a drift check."""
    change, days = state["change"], float(_numbers(state["days"]))
    values = _numbers([change["cor_column_mm"], change["tilt_rad"]], 2)
    return {"days": days, "change": DetectorEstimate.of(values, _numbers(change["covariance"], 2, 2))}


def _baseline(state: Mapping[str, Any]) -> Baseline:
    estimate = state["estimate"]
    looks, outliers = (int(_numbers(estimate[name])) for name in ("looks", "outliers"))
    pooled_looks = PooledDriftCheckPoint(**_look(estimate), looks=looks, outliers=outliers)
    return Baseline(pooled_looks, float(_numbers(state["until_days"])))


def _history(state: Mapping[str, Any]) -> History:
    scatter, shapes = state["scatter"], {"squares": (2, 2), "mean": (2,), "covariance": (2, 2)}
    of_segment = {"first_days": (), "last_days": (), "precision": (3, 2, 2), "weighted": (2, 2)}
    return History(
        tuple(
            Segment(int(_numbers(each["groups"])), *(_numbers(each[name], *of_segment[name]) for name in of_segment))
            for each in state["segments"]
        ),
        LookSpread(int(_numbers(scatter["differences"])), *(_numbers(scatter[name], *shapes[name]) for name in shapes)),
    )
