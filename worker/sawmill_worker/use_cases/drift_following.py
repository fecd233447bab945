"""A scanner's drift chart, continued look by look: what housekeeping calls, on plain values."""

import math
from collections import deque
from collections.abc import Iterable
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from sawmill_worker.contracts.choices import DriftMethod
from sawmill_worker.contracts.scanner_drift import CountedLook, DriftFinding, Followed, LooksBefore, Pool
from sawmill_worker.tomography.drift_chart.chart import DriftChart, Finding
from sawmill_worker.tomography.drift_chart.looks import Look, pooled
from sawmill_worker.tomography.drift_chart.state import chart_from_state, chart_to_state
from sawmill_worker.use_cases.drift_baseline import known_baseline

# Looks that the pooled line takes together: 36 minutes of a day of 2 000 logs.
POOLED_LOOKS = 50


def follow(
    state: dict[str, Any] | None, method: DriftMethod, before: LooksBefore, looks: list[CountedLook]
) -> Followed:
    """Continue a chart with one look or more; a state of another version's layout is begun anew from all looks."""
    chart = _chart(state, before)
    window = deque(map(_look, before(POOLED_LOOKS)), maxlen=POOLED_LOOKS)
    start = looks[0].at - timedelta(days=looks[0].days)
    finding, baseline, alarm, pools = _reported(chart.finding(), start), None, None, []
    for counted in looks:
        look, known = _look(counted), chart
        chart = known.with_look(look)
        window.append(look)
        if chart.baseline is not None and known.baseline is None:
            first_at, last_at = (
                start + timedelta(days=days) for days in (known.pending[0].days, chart.baseline.until_days)
            )
            baseline = known_baseline(chart.baseline, method, first_at, last_at)
        if chart.history is not known.history:
            found = chart.finding()
            finding = _reported(found, start)
            if found.alarm and alarm is None:
                alarm = (finding, counted.at)
        pools.append(_pool(window, counted, finding.scatter))
    return Followed(chart_to_state(chart), baseline, finding, alarm, pools)


def _chart(state: dict[str, Any] | None, before: LooksBefore) -> DriftChart:
    if state is None:
        return DriftChart()
    try:
        return chart_from_state(state)
    except ValueError:
        return _continued(DriftChart(), before(None))


def _continued(chart: DriftChart, looks: Iterable[CountedLook]) -> DriftChart:
    for counted in looks:
        chart = chart.with_look(_look(counted))
    return chart


def _look(counted: CountedLook) -> Look:
    change = np.array([counted.cor_column_change_mm, counted.tilt_change_rad])
    return Look(counted.days, change, np.array(counted.covariance))


def _pool(window: Iterable[Look], newest: CountedLook, scatter: float) -> Pool:
    """As the looks measured it, and as uncertain as they scatter."""
    together = pooled(list(window))
    calibrated = np.array([newest.cor_column_mm, newest.tilt_rad]) - [
        newest.cor_column_change_mm,
        newest.tilt_change_rad,
    ]
    (column, tilt), (column_deviation, tilt_deviation) = calibrated + together.change, scatter * together.deviation
    return Pool(together.looks, float(column), float(column_deviation), float(tilt), float(tilt_deviation))


def _reported(found: Finding, start: datetime) -> DriftFinding:
    plain = DriftFinding(kind=found.kind.value, evidence=found.evidence, limit=found.limit, scatter=found.scatter)
    if found.began_days is None or found.between_days is None or found.change is None or found.covariance is None:
        return plain
    (column, tilt), (column_deviation, tilt_deviation) = found.change, np.sqrt(np.diag(found.covariance))
    first, last = (start + timedelta(days=days) for days in found.between_days)
    return plain.model_copy(
        update={
            "began_at": start + timedelta(days=found.began_days),
            "began_between": (first, last),
            "cor_column_change_mm": float(column),
            "cor_column_standard_deviation_mm": float(column_deviation),
            "tilt_change_deg": math.degrees(tilt),
            "tilt_standard_deviation_deg": math.degrees(tilt_deviation),
        }
    )
