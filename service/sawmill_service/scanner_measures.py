"""Metrics of each scanner: ray errors, movement, tolerances, and the ages of calibration and drift check."""

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime

from prometheus_client.core import GaugeMetricFamily, Metric

from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.calibrations import Accuracy
from sawmill_service.scanner_conditions import ScannerCondition

_TEXTS = {
    "ray_error_millimeters": "Predicted RMS ray error of the calibration: active or newest.",
    "ray_error_upper_95_millimeters": "RMS ray error not exceeded with 95 %, of the calibration: active or newest.",
    "ray_error_tolerance_millimeters": "Largest `sawmill_scanner_ray_error_upper_95_millimeters` that is allowed.",
    "movement_millimeters": "RMS ray change, seen by: drift, the newest check that could tell, against the active "
    "calibration; calibration, the newest one against the one that was active.",
    "movement_tolerance_millimeters": "Largest ray change that is allowed.",
    "in_tolerance": "0: the page shows the scanner red; 1: good or to be watched; absent without a calibration.",
    "red_known": "1: the page shows the scanner red, and somebody has acknowledged that until a time.",
    "calibration_failed": "Whether the last calibration failed, or failed its check.",
    "calibration_age_seconds": "Time since the newest calibration that succeeded was requested.",
    "drift_check_age_seconds": "Time since the newest drift check that ended was requested.",
    "alarm": "1: an alarm is open, of any scanner; 0: none, of the 200 newest scanners.",
}
_FURTHER_LABELS = {
    "ray_error_millimeters": "calibration",
    "ray_error_upper_95_millimeters": "calibration",
    "movement_millimeters": "seen_by",
    "alarm": "kind",
}
Value = tuple[str, str | None, float]


def scanner_measures(
    conditions: Sequence[ScannerCondition], alarms: Iterable[Alarm], now: datetime
) -> Iterator[Metric]:
    """Yield a metric family for each measure, with a value for each scanner that has one and for every alarm."""
    families = {
        name: GaugeMetricFamily(
            f"sawmill_scanner_{name}", text, labels=["scanner", *filter(None, [_FURTHER_LABELS.get(name)])]
        )
        for name, text in _TEXTS.items()
    }
    for condition in conditions:
        for name, further, value in _values(condition, now):
            families[name].add_metric([condition.scanner.id, *filter(None, [further])], value)
    opened = {(alarm.scanner_id, alarm.kind) for alarm in alarms}
    of_conditions = {(condition.scanner.id, what) for condition in conditions for what in AlarmKind}
    for scanner_id, what in sorted(opened | of_conditions):
        families["alarm"].add_metric([scanner_id, what], int((scanner_id, what) in opened))
    yield from families.values()


def _values(condition: ScannerCondition, now: datetime) -> Iterator[Value]:
    scanner, newest = condition.scanner, condition.newest
    yield "ray_error_tolerance_millimeters", None, scanner.tolerances.predicted_ray_error_mm
    yield "movement_tolerance_millimeters", None, scanner.tolerances.ray_change_mm
    failed = condition.failure is not None or (newest is not None and newest.verdict == "fail")
    yield "red_known", None, int(condition.known is not None)
    yield "calibration_failed", None, int(failed)
    yield from _ray_errors("active", condition.active)
    if newest is not None:
        yield "in_tolerance", None, int(condition.step.tone != "bad")
        yield "calibration_age_seconds", None, _age_s(newest.created_at, now)
        yield from _ray_errors("newest", newest)
        if newest.comparison is not None:
            yield "movement_millimeters", "calibration", newest.comparison.ray_change_mm
    if condition.drift is not None:
        yield "drift_check_age_seconds", None, _age_s(condition.drift.created_at, now)
    if condition.seen is not None and condition.seen.result is not None:
        yield "movement_millimeters", "drift", condition.seen.result.ray_change_mm


def _ray_errors(which: str, accuracy: Accuracy | None) -> Iterator[Value]:
    predicted = None if accuracy is None else accuracy.predicted_ray_error_mm
    if predicted is not None:
        yield "ray_error_millimeters", which, predicted.rms
        yield "ray_error_upper_95_millimeters", which, predicted.upper_95


def _age_s(then: datetime, now: datetime) -> float:
    return max((now - then).total_seconds(), 0.0)
