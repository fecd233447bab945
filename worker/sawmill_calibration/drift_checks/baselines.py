"""Baselines of drift checks, from a chart or from the answers of earlier checks, and a scanner's drift chart.

Housekeeping continues a chart drift check by drift check, on plain values.
"""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from sawmill_calibration.failures import refused
from sawmill_calibration.view_vectors import AnyGeometry
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.choices import DriftMethod
from sawmill_contracts.drifts import DriftResult, KnownBaseline
from sawmill_contracts.scanner_drift import POOLED_LOOKS, CountedLook, DriftFinding, Followed
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.base import placed_complaint
from sawmill_tomography.drift.chart.chart import ChartFinding, DriftChart, chart_from_state, chart_to_state
from sawmill_tomography.drift.chart.looks import Baseline, DriftCheckPoint, inverse, pooled_means, stacked
from sawmill_vocabulary import DetectorEstimate

# Answers written by the service or the command line have a few kilobytes.
LONGEST_ANSWER = 1_000_000


def known_baseline(
    baseline: Baseline, method: DriftMethod, first_at: datetime | None, last_at: datetime | None
) -> KnownBaseline:
    """Convert a baseline to its contract."""
    zero = baseline.estimate
    return KnownBaseline(
        method=method,
        checks=zero.looks,
        outliers=zero.outliers,
        first_at=first_at,
        last_at=last_at,
        cor_column_offset_mm=zero.change.cor_column_mm,
        tilt_offset_rad=zero.change.tilt_rad,
        covariance=[list(row) for row in zero.change.covariance],
    )


def read_answers(paths: Iterable[Path]) -> Iterator[tuple[str, DriftResult]]:
    """Read the output of `drift --json`, or the service's answers, with each file's name; refuse any other file."""
    yield from ((path.name, _read(path)) for path in paths)


def baselines_of(
    answers: Iterable[tuple[str, DriftResult]], calibration: AnyGeometry, checked_sha256: str
) -> tuple[KnownBaseline, ...]:
    """Compute baselines from earlier drift checks, one for each method, or refuse them.

    They must be against this calibration, each of another scan than the checked one and enough of a method.
    """
    if not isinstance(calibration, CalibrationResult):
        raise refused("baseline", "a baseline is of checks against a calibration: give one, or leave the baseline out")
    by_method: dict[DriftMethod, dict[str, DriftResult]] = {}
    for name, result in answers:
        reason = _why_not(result, calibration, checked_sha256)
        if reason is not None:
            raise refused("baseline", f"{name} {reason}")
        if result.method is not None:  # else `_why_not` has a reason
            earlier = by_method.setdefault(result.method, {})
            if result.input_sha256 in earlier:
                raise refused("baseline", f"{name} is of a scan that an earlier answer is of: give each scan once")
            earlier[result.input_sha256] = result
    return tuple(_of(method, list(results.values())) for method, results in by_method.items())


def _of(method: DriftMethod, results: Sequence[DriftResult]) -> KnownBaseline:
    try:
        baseline = Baseline.of([DriftCheckPoint(0.0, result.detector_change) for result in results])
    except ValueError as error:
        raise refused("baseline", f"by {method}, {error}") from error
    times = [result.at for result in results if result.at is not None]
    return known_baseline(baseline, method, min(times, default=None), max(times, default=None))


def _why_not(result: DriftResult, calibration: CalibrationResult, checked_sha256: str) -> str | None:
    """Return why an answer cannot be in a baseline, as the end of a sentence that begins with its name."""
    if result.input_sha256 == checked_sha256:
        return "is of the scan that is checked: a baseline is of earlier ones"
    if result.method is None:
        return "does not say how views were compared, as an earlier version wrote it: check that scan again"
    if result.reference == "given-geometry":
        return "is of a check without a calibration"
    frame = calibration.source_frame
    calibrated = (frame.cor_column_mm, frame.tilt_rad, frame.source_to_detector_mm)
    then = result.calibrated
    if (
        then.cor_column_mm,
        then.tilt_rad,
        then.source_to_detector_mm,
    ) != calibrated or result.scanner != calibration.scanner:
        return "is of a check against another calibration: a baseline is of checks against the one that is given"
    if result.rotation is not calibration.rotation:
        return "is of a log that turned the other way than at the calibration"
    return None


def _read(path: Path) -> DriftResult:
    try:
        with path.open("rb") as stream:
            document = json.loads(stream.read(LONGEST_ANSWER + 1)[:LONGEST_ANSWER])
        inner = document.get("result", document)
        return DriftResult.model_validate({name: value for name, value in inner.items() if name != "state"})
    except ValidationError as error:
        raise _refused(path, placed_complaint(error)) from error
    except (AttributeError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise _refused(path, "it is no JSON document of an answer") from error


def _refused(path: Path, reason: str) -> JobFailure:
    return refused("baseline", f"{path.name} is not what drift --json prints, nor the service's answer: {reason}")


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
