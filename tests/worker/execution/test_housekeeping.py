import threading
import time
from contextlib import contextmanager, redirect_stderr, suppress
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest
import structlog
from live_service import wait_until
from machine_faults import database_away
from sqlalchemy import insert, text, update
from structlog.testing import capture_logs

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.retention import RetentionKind, RetentionRequest, RetentionRules
from sawmill_contracts.scanners import AlarmLimits
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.webhooks import WebhookRequest
from sawmill_platform.database.tables import REMOVABLE, DeliveryRow, EventRow, JobRow
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.webhooks.outbox import DeliveryAttempt
from sawmill_platform.webhooks.webhook_store import KEPT
from sawmill_platform.workers.logs import configure_logs
from sawmill_store.mill_tables import ActivationRow, MeasurementRow, ScannerRow
from sawmill_store.retention.removable_rows import REMOVABLE_ROWS
from sawmill_worker.housekeeping import MillHousekeeping

pytestmark = pytest.mark.slow


@contextmanager
def running(store, settings):
    stop = threading.Event()
    housekeeping = MillHousekeeping(store, settings, stop)
    housekeeping.start()
    try:
        yield
    finally:
        stop.set()
        housekeeping.join()


def test_it_sees_to_expired_leases_and_due_schedules(store, settings, queue):
    job = queue("succeed")
    store.jobs.claim("lost")
    schedule = store.schedules.create(
        ScheduleSpec(scanner_id=store.scans.get(job.subject_id).scanner_id, cron="* * * * *")
    )
    with store.database.write() as session:
        session.connection().exec_driver_sql("UPDATE schedules SET next_due_at = created_at")
    with running(store, settings):
        wait_until(lambda: store.jobs.get(job.id).state is JobState.QUEUED)
        wait_until(lambda: store.schedules.get(schedule.id).last_run is not None)


@pytest.fixture
def seconds():
    return SimpleNamespace(now_s=1000.0)


@pytest.fixture
def housekeeping(store, settings, seconds):
    return MillHousekeeping(store, settings, threading.Event(), monotonic=lambda: seconds.now_s)


def test_it_looks_at_alarms_at_once_and_then_each_minute(store, housekeeping, seconds, queue):
    scanner_id = store.scans.get(queue("succeed").subject_id).scanner_id
    known = store.scanners.get(scanner_id)
    store.scanners.update(scanner_id, known.model_copy(update={"alarms": AlarmLimits(quiet_after_hours=1e-6)}))
    time.sleep(0.05)
    with capture_logs() as log:
        housekeeping.once()
    assert [entry["kind"] for entry in log if entry["event"] == "alarm-opened"] == ["scanner-quiet"]
    assert [alarm.kind for alarm in store.alarms.open()] == ["scanner-quiet"]
    store.scanners.update(scanner_id, known)
    housekeeping.once()
    assert len(store.alarms.open()) == 1
    seconds.now_s += 60.0
    housekeeping.once()
    assert store.alarms.open() == []


def test_a_drift_check_that_ended_goes_into_its_scanner_s_chart(store, settings, queue):
    scan = store.scans.get(queue("succeed").subject_id)
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan.id, phantom_id="l-shape"))
    since = store.now() - timedelta(hours=1)
    with store.database.write() as session:
        about = {"scanner_id": scan.scanner_id, "calibration_id": calibration.id}
        active = ActivationRow(**about, activated_at=since, reason="by hand")
        session.add(active)
        session.flush()
        values = {"cor_column_mm": -209.0, "cor_column_standard_deviation_mm": 0.05, "cor_column_change_mm": 0.1}
        values |= {"tilt_rad": -0.08, "tilt_standard_deviation_rad": 0.002, "tilt_change_rad": 0.0}
        values |= {"covariance": [[0.0025, 0.0], [0.0, 4e-6]], "source_to_detector_mm": 1619.3}
        values |= {"relative_residual": 0.01, "method": "view-pairs", "awaits_chart": True, "at": store.now()}
        values |= {"kind": MeasurementKind.DRIFT, "subject_id": "check"}
        session.add(MeasurementRow(scanner_id=scan.scanner_id, activation_number=active.number, **values))
        known = session.get_one(ScannerRow, scan.scanner_id)
        session.add(ScannerRow(id="a-first-one", created_at=since, spec=known.spec))
        session.flush()
        # Of an activation that is not there: its chart cannot be made.
        session.add(MeasurementRow(scanner_id="a-first-one", activation_number=1_000, **values))
    with capture_logs() as log:
        MillHousekeeping(store, settings, threading.Event()).once()
    put_off = [(entry["event"], entry["scanner_id"]) for entry in log if entry["log_level"] == "error"]
    assert put_off == [("drift-chart-put-off", "a-first-one")]
    (chart,) = store.drift_charts.of_scanner(scan.scanner_id).charts
    assert (chart.checks, chart.finding.kind, chart.calibration_id) == (1, "learning", calibration.id)
    assert (chart.pooled_checks, chart.pooled_cor_column_mm) == (1, pytest.approx(-209.0))


def test_old_deliveries_are_forgotten_each_minute(store, housekeeping, seconds):
    webhook = store.webhooks.create(WebhookRequest(url="https://alarms.mill.example/", events=["*"]))
    store.webhooks.rotate(webhook.id, grace_s=0)
    outbox = store.outbox()
    pending = outbox.pending(webhook.id, store.events.newest_number())
    outbox.note(pending, pending.events[0], DeliveryAttempt(200))
    housekeeping.once()
    assert len(store.webhooks.deliveries(webhook.id).items) == 1
    with store.database.write() as session:
        session.execute(update(DeliveryRow).values(last_at=store.now() - KEPT - timedelta(seconds=1)))
    housekeeping.once()
    assert len(store.webhooks.deliveries(webhook.id).items) == 1
    seconds.now_s += 60.0
    housekeeping.once()
    assert store.webhooks.deliveries(webhook.id).items == []


def test_many_batches_go_by_the_rules_of_retention_in_a_round(store, housekeeping, queue):
    job = queue("succeed")
    rules, batch = RetentionRules(events_days=1), REMOVABLE_ROWS[RetentionKind.EVENTS].batch
    store.retention.replace(RetentionRequest(**rules.model_dump(), remove_at_most=10_000))
    ago = store.now() - timedelta(days=2)
    (queued,) = (each for each in store.events.following(0) if each.job_id == job.id)
    more = {"at": ago, "type": queued.type, "subject": queued.subject, "subject_id": queued.subject_id}
    with store.database.write() as session:
        session.execute(insert(EventRow), [more] * (2 * batch))
        session.execute(update(EventRow).where(text(REMOVABLE)).values(at=ago))
        session.execute(update(JobRow).values(state=JobState.CANCELLED))
    housekeeping.once()
    (went,) = (each.number for each in store.retention.get().removed if each.number)
    assert batch < went <= 2 * batch, "the newest scan's event stays, and decisions"


class Trouble(Jobs):
    """Jobs of a database that does not answer at some looks."""

    looks = 0
    answers_from = 2

    def pulses(self):
        self.looks += 1
        if self.looks < self.answers_from:
            raise StorageUnavailable("the database does not answer: away")
        return super().pulses()


def test_trouble_is_logged_and_the_next_round_comes(store_with, settings):
    troubled = store_with(Trouble)
    with capture_logs() as log, running(troubled, settings):
        wait_until(lambda: troubled.jobs.looks > 1)
    assert [(entry["event"], entry["duty"]) for entry in log] == [("housekeeping-put-off", "take_back_silent")]


def test_an_outage_of_all_duties_is_one_line(store, housekeeping):
    with capture_logs() as log, database_away(store.database):
        for _ in range(5):
            housekeeping.once()
    assert [entry["event"] for entry in log] == ["files-not-looked-after", "housekeeping-put-off"]


def test_a_log_that_cannot_be_written_stops_nothing(store_with, settings):
    """Standard error is often a file on the disk that is full."""

    class AwayForGood(Trouble):
        answers_from = 10**9

    troubled, before = store_with(AwayForGood), structlog.get_config()
    with suppress(OSError), Path("/dev/full").open("w") as full, redirect_stderr(full):
        configure_logs("json")
        try:
            with running(troubled, settings):
                wait_until(lambda: troubled.jobs.looks > 2)
        finally:
            structlog.configure(**before)
