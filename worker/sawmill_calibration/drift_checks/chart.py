"""A scanner's drift chart, continued drift check by drift check, on plain values; housekeeping calls it."""

import math
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from itertools import groupby
from typing import Any

import numpy as np

from sawmill_calibration.drift_checks.baselines import known_baseline
from sawmill_contracts.choices import DriftMethod
from sawmill_contracts.scanner_drift import POOLED_LOOKS, CountedLook, DriftFinding, Followed
from sawmill_tomography.drift.chart.chart import ChartFinding, DriftChart
from sawmill_tomography.drift.chart.looks import DriftCheckPoint, pooled_means, stacked
from sawmill_tomography.drift.chart.spread import inverse
from sawmill_tomography.drift.chart.state import chart_from_state, chart_to_state
from sawmill_vocabulary import DetectorEstimate


def follow(
    state: dict[str, Any], method: DriftMethod, before: list[CountedLook], looks: list[CountedLook]
) -> Followed | None:
    """Continue a chart with one or more drift checks; return None if the state was written by another version."""
    try:
        chart = chart_from_state(state) if state else DriftChart()
    except ValueError:
        return None
    start = looks[0].at - timedelta(days=looks[0].days)
    finding, baseline, alarm, scatters = _reported(chart.finding(), start), None, None, []
    for counted in looks:
        previous, chart = chart, chart.with_look(DriftCheckPoint(counted.days, counted.change))
        if chart.baseline is not None and previous.baseline is None:
            first_at, last_at = (
                start + timedelta(days=days) for days in (previous.pending[0].days, chart.baseline.until_days)
            )
            baseline = known_baseline(chart.baseline, method, first_at, last_at)
        if chart.history is not previous.history:
            newest = chart.finding()
            finding = _reported(newest, start)
            if newest.alarm and alarm is None:
                alarm = (finding, counted.at)
        scatters.append(finding.scatter)
    return Followed(chart_to_state(chart), baseline, finding, alarm, list(_pools(before, looks, scatters)))


def _pools(
    before: Sequence[CountedLook], looks: Sequence[CountedLook], scatters: Sequence[float]
) -> Iterator[tuple[DetectorEstimate, int]]:
    """Yield for each drift check the mean of the latest checks, as uncertain as the checks scatter by then."""
    change, covariance = stacked([counted.change for counted in (*before, *looks)])
    newest = iter(zip(looks, scatters, strict=True))
    ends = range(len(before) + 1, len(before) + len(looks) + 1)
    for number, its_ends in groupby(ends, lambda end: min(end, POOLED_LOOKS)):
        which = np.array([range(end - number, end) for end in its_ends])
        means = pooled_means(change[which], covariance[which])
        for mean, own in zip(means.mean, inverse(means.precision), strict=True):
            counted, scatter = next(newest)
            yield DetectorEstimate.of(counted.calibrated + mean, scatter**2 * own), number


def _reported(finding: ChartFinding, start: datetime) -> DriftFinding:
    plain = DriftFinding(
        kind=finding.kind.value, evidence=finding.evidence, limit=finding.limit, scatter=finding.scatter
    )
    if finding.began_days is None or finding.between_days is None or finding.change is None:
        return plain
    (column, tilt), (column_deviation, tilt_deviation) = finding.change.values, finding.change.deviations
    # Checks have the clock times at which they ended, and the clock may have been set back.
    first, last = sorted(finding.between_days)
    return plain.model_copy(
        update={
            "began_at": start + timedelta(days=min(max(finding.began_days, first), last)),
            "began_between": (start + timedelta(days=first), start + timedelta(days=last)),
            "cor_column_change_mm": column,
            "cor_column_standard_deviation_mm": column_deviation,
            "tilt_change_deg": math.degrees(tilt),
            "tilt_standard_deviation_deg": math.degrees(tilt_deviation),
        }
    )
