"""Metrics of the store, scanners and webhooks, counted when read (docs/look-up/metrics.md); labels are closed sets."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import TypeVar

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
    SummaryMetricFamily,
)
from prometheus_client.registry import Collector

from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.calibrations import Accuracy
from sawmill_contracts.failure_codes import DEFECTS, OTHER, counted_as
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import FailureKind, JobKind, JobState
from sawmill_platform.contracts.webhooks import Webhook, WebhookState
from sawmill_platform.errors import FolderUnavailable, StorageMisconfigured, StorageUnavailable
from sawmill_platform.jobs.tallies import DURATIONS_S, NONE, Amount, Fate, Tally
from sawmill_service.routes.health import PATIENCE_S
from sawmill_service.scanner_conditions import ScannerCondition, conditions_of
from sawmill_store.store import Store

Key = TypeVar("Key", bound=Hashable)
FOLDER_UP = "Whether the data folder can be read; if not, the metrics of its disk are absent."
RESERVE = "`SAWMILL_DISK_RESERVE_BYTES`: with fewer free bytes, uploads are refused and jobs wait."
DATABASE_UP = "Whether the database answers; if not, the metrics that are counted in it are absent."
WITHOUT_WORKER = "Whether a job could start, for 30 s now, and none runs: `without-worker` of `/health/ready`."
OUTCOMES = (
    event_kinds.SUCCEEDED,
    event_kinds.FAILED,
    event_kinds.CANCELLED,
    event_kinds.LOST,
    event_kinds.POSTPONED,
    event_kinds.GIVEN_BACK,
)


class Measures(Collector):
    """Collector of metrics; without the database or the data folder it reports their absence and leaves the rest out.

    Requests that come during a count share one count that starts after they came.
    """

    def __init__(self, store: Store, *, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._store, self._clock_s = store, clock_s
        self._lock = threading.Lock()
        self._begun_at = float("-inf")
        self._counted: list[Metric] = []

    def collect(self) -> Iterable[Metric]:
        """Count everything in its present state."""
        came_at = self._clock_s()
        with self._lock:
            if self._begun_at < came_at:
                begun_at = self._clock_s()
                self._counted, self._begun_at = [*_folder(self._store), *_database(self._store)], begun_at
            return self._counted


def _folder(store: Store) -> Iterator[Metric]:
    try:
        room = store.files.room()
    except FolderUnavailable:
        yield gauge("sawmill_data_folder_up", FOLDER_UP, 0)
        return
    yield gauge("sawmill_data_folder_up", FOLDER_UP, 1)
    yield gauge("sawmill_data_folder_free_bytes", "Free bytes of the data folder's disk.", room.free_bytes)
    yield gauge("sawmill_data_folder_size_bytes", "Bytes of the data folder's disk.", room.size_bytes)
    yield gauge("sawmill_data_folder_reserve_bytes", RESERVE, store.settings.disk_reserve_bytes)


def _database(store: Store) -> Iterator[Metric]:
    try:
        tally, conditions, removed = store.tallies.read(), conditions_of(store), store.retention.get().removed
        waiting = store.jobs.queued_job_ids(older_than_s=PATIENCE_S, limit=1)
        places = list(_places(store))
        scanners = list(scanner_measures(conditions, store.alarms.open(), tally.at))
        webhooks = list(webhook_measures(store.webhooks.all(), tally.at))
    except (StorageUnavailable, StorageMisconfigured):
        yield gauge("sawmill_database_up", DATABASE_UP, 0)
        return
    yield gauge("sawmill_database_up", DATABASE_UP, 1)
    yield from _jobs(tally)
    yield gauge("sawmill_jobs_without_worker", WITHOUT_WORKER, int(bool(waiting) and not tally.running_s))
    yield gauge(
        "sawmill_workers_seen",
        "Workers that hold an attempt, or did within ten minutes; an idle one is not seen.",
        tally.workers,
    )
    yield from places
    yield from _attempts(tally.fates)
    numbers = CounterMetricFamily("sawmill_retention_removed", "Items removed by retention rules.", labels=["kind"])
    for each in removed:
        numbers.add_metric([each.kind], each.number)
    yield numbers
    yield from scanners
    yield from webhooks


def _places(store: Store) -> Iterator[Metric]:
    most, of_a_key = store.settings.max_queued_jobs, store.settings.max_queued_jobs_per_key
    yield gauge(
        "sawmill_queued_jobs_limit", "`SAWMILL_MAX_QUEUED_JOBS`: with as many queued jobs, new ones get 429.", most
    )
    text = "`SAWMILL_MAX_QUEUED_JOBS_PER_KEY`: with as many queued jobs of one key, new ones of the key get 429."
    yield gauge("sawmill_queued_jobs_of_a_key_limit", text, of_a_key)
    fullest = store.places.waiting().most_of_a_key
    yield gauge("sawmill_queued_jobs_of_a_key", "Queued jobs of the key that has most; 0: no key has any.", fullest)


def gauge(name: str, text: str, value: float) -> GaugeMetricFamily:
    """Make a metric of one number."""
    return GaugeMetricFamily(name, text, value=value)


def _jobs(tally: Tally) -> Iterator[Metric]:
    by_state = GaugeMetricFamily("sawmill_jobs", "Jobs by state.", labels=["state"])
    by_kind = GaugeMetricFamily("sawmill_jobs_by_kind", "Jobs by kind and state.", labels=["kind", "state"])
    for state in JobState:
        numbers = {kind: tally.jobs.get((kind, state), 0) for kind in JobKind.all()}
        by_state.add_metric([state], sum(numbers.values()))
        for kind, number in numbers.items():
            by_kind.add_metric([kind, state], number)
    yield by_state
    yield by_kind
    yield _by_kind(
        "sawmill_oldest_queued_job_seconds",
        "Age of the oldest queued job, also if it waits for another job; 0: none.",
        tally.queued_s,
    )
    yield _by_kind(
        "sawmill_longest_running_job_seconds", "Time since the first running job started; 0: none.", tally.running_s
    )


def _attempts(fates: Mapping[Fate, Amount]) -> Iterator[Metric]:
    text = f"Attempts that ended, by outcome: {', '.join(OUTCOMES)}."
    outcomes = CounterMetricFamily("sawmill_attempts", text, labels=["kind", "outcome"])
    by_outcome = _summed(fates, lambda fate: (fate.kind, fate.type))
    for kind in JobKind.all():
        for what in OUTCOMES:
            outcomes.add_metric([kind, what], by_outcome[kind, what].number)
    yield outcomes
    yield _failures(fates)
    yield _durations(fates)
    by_kind = _summed(fates, lambda fate: fate.kind)
    text = (
        "Peak of the resident memory of attempts, memory shared with the parent process included; none of killed ones."
    )
    memory = SummaryMetricFamily("sawmill_attempt_peak_memory_bytes", text, labels=["kind"])
    for kind in JobKind.all():
        memory.add_metric([kind], count_value=by_kind[kind].measured, sum_value=by_kind[kind].peak_bytes)
    yield memory
    most = {kind: by_kind[kind].most_bytes for kind in JobKind.all()}
    yield _by_kind("sawmill_attempt_peak_memory_max_bytes", "The largest peak memory of an attempt; 0: none.", most)


def _failures(fates: Mapping[Fate, Amount]) -> Metric:
    """Count failures; defects are 0 before the first one, because Prometheus sees no increase in a new series."""
    failed = {fate: amount for fate, amount in fates.items() if fate.type is event_kinds.FAILED}
    numbers = {(kind, FailureKind.INTERNAL.value, code): 0 for kind in JobKind.all() for code in sorted(DEFECTS)}
    for key, amount in _summed(failed, lambda fate: (fate.kind, _fault(fate), counted_as(fate.code))).items():
        numbers[key] = amount.number
    text = "Jobs that failed, by fault: input, passing or internal, which is a defect; an unknown code counts as other."
    family = CounterMetricFamily("sawmill_job_failures", text, labels=["kind", "fault", "code"])
    for key, number in numbers.items():
        family.add_metric(key, number)
    return family


def _fault(fate: Fate) -> str:
    return fate.fault if fate.fault in set(FailureKind) else OTHER


def _durations(fates: Mapping[Fate, Amount]) -> Metric:
    succeeded = {fate: amount for fate, amount in fates.items() if fate.type is event_kinds.SUCCEEDED}
    numbers = _summed(succeeded, lambda fate: (fate.kind, fate.duration))
    seconds = _summed(succeeded, lambda fate: fate.kind)
    ends = [*(f"{end_s:g}" for end_s in DURATIONS_S), "+Inf"]
    text = "Seconds from the start of the attempt that succeeded to its end."
    family = HistogramMetricFamily("sawmill_job_duration_seconds", text, labels=["kind"])
    for kind in JobKind.all():
        counted, buckets = 0, []
        for duration, end in enumerate(ends):
            counted += numbers[kind, duration].number
            buckets.append((end, counted))
        family.add_metric([kind], buckets, sum_value=seconds[kind].seconds)
    return family


def _summed(fates: Mapping[Fate, Amount], key: Callable[[Fate], Key]) -> defaultdict[Key, Amount]:
    sums: defaultdict[Key, Amount] = defaultdict(lambda: NONE)
    for fate, amount in fates.items():
        sums[key(fate)] = sums[key(fate)].with_more(amount)
    return sums


def _by_kind(name: str, text: str, values: Mapping[JobKind, float]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, text, labels=["kind"])
    for kind in JobKind.all():
        family.add_metric([kind], values.get(kind, 0.0))
    return family


_GAUGES = {
    "waiting": "Events that wait to be sent, 10 000 at most.",
    "oldest_waiting_seconds": "Age of the oldest event that waits; 0: none does.",
    "paused": "Whether the service gave up on the webhook.",
}


def webhook_measures(webhooks: Iterable[Webhook], now: datetime) -> Iterator[Metric]:
    """Yield a metric family for each measure, with a value for each webhook."""
    sent = CounterMetricFamily(
        "sawmill_webhook_deliveries",
        "Attempts to deliver an event, by outcome: delivered, failed.",
        labels=["webhook", "outcome"],
    )
    gauges = [GaugeMetricFamily(f"sawmill_webhook_{name}", text, labels=["webhook"]) for name, text in _GAUGES.items()]
    for webhook in webhooks:
        sent.add_metric([webhook.id, "delivered"], webhook.delivered)
        sent.add_metric([webhook.id, "failed"], webhook.failed)
        since = webhook.waiting_since
        age_s = 0.0 if since is None else max(0.0, (now - since).total_seconds())
        values = (webhook.waiting, age_s, int(webhook.state is WebhookState.PAUSED))
        for family, value in zip(gauges, values, strict=True):
            family.add_metric([webhook.id], value)
    yield sent
    yield from gauges


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
