"""A drift chart as numbers, lists and dictionaries, which JSON keeps without loss."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sawmill_tomography.drift.chart.chart import GROUP_LOOKS, DriftChart, History
from sawmill_tomography.drift.chart.looks import Baseline, DriftCheckPoint, LookSpread, PooledDriftCheckPoint
from sawmill_tomography.drift.chart.segments import Segment
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DetectorEstimate

# Version of the layout below: a chart of another layout is built again from the drift checks.
LAYOUT = 2


def chart_to_state(chart: DriftChart) -> dict[str, Any]:
    """Convert a chart for `chart_from_state`: some kilobytes, growing with the logarithm of the number of checks."""
    baseline, history = chart.baseline, chart.history
    return {
        "layout": LAYOUT,
        "pending": [_look_to_state(look) for look in chart.pending],
        "newest": [_look_to_state(look) for look in chart.newest],
        "baseline": baseline
        and {
            **_look_to_state(baseline.estimate),
            "looks": baseline.estimate.looks,
            "outliers": baseline.estimate.outliers,
            "until_days": baseline.until_days,
        },
        "history": history
        and {
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


def _look_to_state(look: DriftCheckPoint) -> dict[str, Any]:
    return {"days": look.days, "change": look.change.values, "covariance": look.change.covariance}


def _look(state: Mapping[str, Any]) -> dict[str, Any]:
    change = DetectorEstimate.of(_numbers(state["change"], 2), _numbers(state["covariance"], 2, 2))
    return {"days": float(_numbers(state["days"])), "change": change}


def _baseline(state: Mapping[str, Any]) -> Baseline:
    looks, outliers = (int(_numbers(state[name])) for name in ("looks", "outliers"))
    return Baseline(
        PooledDriftCheckPoint(**_look(state), looks=looks, outliers=outliers), float(_numbers(state["until_days"]))
    )


def _history(state: Mapping[str, Any]) -> History:
    scatter = state["scatter"]
    return History(
        tuple(_segment(segment) for segment in state["segments"]),
        LookSpread(
            int(_numbers(scatter["differences"])),
            _numbers(scatter["squares"], 2, 2),
            _numbers(scatter["mean"], 2),
            _numbers(scatter["covariance"], 2, 2),
        ),
    )


def _segment_to_state(segment: Segment) -> dict[str, Any]:
    return {
        "groups": segment.groups,
        "first_days": float(segment.first_days),
        "last_days": float(segment.last_days),
        "precision": segment.precision.tolist(),
        "weighted": segment.weighted.tolist(),
    }


def _segment(state: Mapping[str, Any]) -> Segment:
    first, last = (_numbers(state[name]) for name in ("first_days", "last_days"))
    precision, weighted = _numbers(state["precision"], 3, 2, 2), _numbers(state["weighted"], 2, 2)
    return Segment(int(_numbers(state["groups"])), first, last, precision, weighted)
