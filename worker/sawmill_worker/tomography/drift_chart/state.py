"""A drift chart as numbers, lists and dictionaries, which JSON keeps without loss."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sawmill_worker.tomography.drift_chart.chart import DriftChart
from sawmill_worker.tomography.drift_chart.history import History
from sawmill_worker.tomography.drift_chart.looks import Baseline, Look, PooledLook
from sawmill_worker.tomography.drift_chart.scatter import Scatter
from sawmill_worker.tomography.drift_chart.segments import Segment

# Of the layout below: a chart of another one is begun anew from the looks.
LAYOUT = 1


def chart_to_state(chart: DriftChart) -> dict[str, Any]:
    """What `chart_from_state` reads: some kilobytes, growing with the logarithm of the number of looks."""
    baseline, history = chart.baseline, chart.history
    return {
        "layout": LAYOUT,
        "pending": [_look_to_state(look) for look in chart.pending],
        "baseline": baseline
        and {
            **_look_to_state(baseline.estimate),
            "looks": baseline.estimate.looks,
            "outliers": baseline.estimate.outliers,
            "until_days": baseline.until_days,
        },
        "history": history
        and {
            "baseline": _segment_to_state(history.baseline),
            "segments": [_segment_to_state(segment) for segment in history.segments],
            "scatter": {
                "differences": history.scatter.differences,
                "squares": history.scatter.squares.tolist(),
                "mean": history.scatter.mean.tolist(),
                "covariance": history.scatter.covariance.tolist(),
            },
        },
    }


def chart_from_state(state: Mapping[str, Any]) -> DriftChart:
    """The chart that gave that state.

    Raises
    ------
    ValueError
        If it is of another layout, or no state of a chart.
    """
    if state.get("layout") != LAYOUT:
        raise ValueError(
            f"the drift chart's layout is {state.get('layout')!r} and must be {LAYOUT}: begin it anew from the looks"
        )
    try:
        baseline, history = state["baseline"], state["history"]
        return DriftChart(
            tuple(Look(**_arrays(look)) for look in state["pending"]),
            baseline and _baseline(baseline),
            history
            and History(
                _segment(history["baseline"]),
                tuple(_segment(segment) for segment in history["segments"]),
                Scatter(**_arrays(history["scatter"])),
            ),
        )
    except (KeyError, TypeError) as wrong:
        raise ValueError(f"this is no state of a drift chart: {wrong}") from wrong


def _arrays(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: np.array(value) if isinstance(value, list) else value for name, value in values.items()}


def _look_to_state(look: Look) -> dict[str, Any]:
    return {"days": look.days, "change": look.change.tolist(), "covariance": look.covariance.tolist()}


def _baseline(state: Mapping[str, Any]) -> Baseline:
    values = _arrays(state)
    until = values.pop("until_days")
    return Baseline(PooledLook(**values), until)


def _segment_to_state(segment: Segment) -> dict[str, Any]:
    return {
        "groups": segment.groups,
        "first_days": float(segment.first_days),
        "last_days": float(segment.last_days),
        "precision": segment.precision.tolist(),
        "weighted": segment.weighted.tolist(),
    }


def _segment(state: Mapping[str, Any]) -> Segment:
    precision, weighted = np.array(state["precision"]), np.array(state["weighted"])
    first, last = (np.asarray(state[name]) for name in ("first_days", "last_days"))
    return Segment(state["groups"], first, last, precision, weighted)
