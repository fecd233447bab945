import errno
import io
import os
import sys
import threading
import time
from datetime import timedelta

import pytest
import structlog
from sqlalchemy import text, update
from structlog.testing import capture_logs

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.retention import RetentionAsk, RetentionRules
from sawmill_contracts.scanners import AlarmLimits
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.webhooks import WebhookAsk
from sawmill_platform.database.tables import REMOVABLE, DeliveryRow, EventRow, JobRow
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.jobs.job_store import Pulse
from sawmill_platform.retention import retention_runner as retiring
from sawmill_platform.webhooks.outbox import DeliveryAttempt
from sawmill_platform.webhooks.webhook_store import KEPT
from sawmill_platform.workers.logs import configure_logs
from sawmill_store.tables import ActivationRow, MeasurementRow, ScannerRow
from sawmill_worker.housekeeping import MillHousekeeping

pytestmark = pytest.mark.slow


def test_it_sees_to_expired_leases_and_due_schedules(store, settings, queue, wait_for):
    job = queue("succeed")
    store.jobs.claim("lost")
    schedule = store.schedules.create(
        ScheduleSpec(scanner_id=store.scans.get(job.subject_id).scanner_id, cron="* * * * *")
    )
    with store.database.write() as session:
        session.connection().exec_driver_sql("UPDATE schedules SET next_due_at = created_at")
    stop = threading.Event()
    housekeeping = MillHousekeeping(store, settings, stop)
    housekeeping.start()
    wait_for(lambda: store.jobs.get(job.id).state is JobState.QUEUED)
    wait_for(lambda: store.schedules.get(schedule.id).last_run is not None)
    stop.set()
    housekeeping.join()


def test_it_looks_at_alarms_at_once_and_then_each_minute(store, settings, queue, monkeypatch):
    scanner_id = store.scans.get(queue("succeed").subject_id).scanner_id
    known = store.scanners.get(scanner_id)
    store.scanners.update(scanner_id, known.model_copy(update={"alarms": AlarmLimits(quiet_after_hours=1e-6)}))
    time.sleep(0.05)
    housekeeping = MillHousekeeping(store, settings, threading.Event())
    with capture_logs() as log:
        housekeeping.once()
    assert [entry["what"] for entry in log if entry["event"] == "alarm-opened"] == ["scanner-quiet"]
    assert [alarm.what for alarm in store.alarms.open()] == ["scanner-quiet"]
    store.scanners.update(scanner_id, known)
    housekeeping.once()
    assert len(store.alarms.open()) == 1
    a_minute_on = time.monotonic() + 60
    monkeypatch.setattr(time, "monotonic", lambda: a_minute_on)
    housekeeping.once()
    assert store.alarms.open() == []


def test_a_drift_check_that_ended_goes_into_its_scanner_s_chart(store, settings, queue):
    scan = store.scans.get(queue("succeed").subject_id)
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=scan.id, phantom_id="l-shape"))
    since = store.now() - timedelta(hours=1)
    with store.database.write() as session:
        about = {"scanner_id": scan.scanner_id, "calibration_id": calibration.id}
        active = ActivationRow(**about, activated_at=since, reason="by hand")
        session.add(active)
        session.flush()
        session.add(
            MeasurementRow(
                scanner_id=scan.scanner_id,
                at=store.now(),
                kind=MeasurementKind.DRIFT,
                subject_id="check",
                cor_column_mm=-209.0,
                cor_column_standard_deviation_mm=0.05,
                cor_column_change_mm=0.1,
                tilt_rad=-0.08,
                tilt_standard_deviation_rad=0.002,
                tilt_change_rad=0.0,
                covariance=[[0.0025, 0.0], [0.0, 4e-6]],
                source_to_detector_mm=1619.3,
                relative_residual=0.01,
                method="view-pairs",
                activation_number=active.number,
                awaits_chart=True,
            )
        )
        (check,) = (row for row in session.new if isinstance(row, MeasurementRow))
        known = session.get_one(ScannerRow, scan.scanner_id)
        session.add(ScannerRow(id="a-first-one", created_at=since, spec=known.spec))
        session.flush()
        # Of an activation that is not there: its chart cannot be made.
        columns = {
            column.name: getattr(check, column.name)
            for column in MeasurementRow.__table__.columns
            if column.name != "number"
        }
        session.add(MeasurementRow(**columns | {"scanner_id": "a-first-one", "activation_number": 1_000}))
    with capture_logs() as log:
        MillHousekeeping(store, settings, threading.Event()).once()
    put_off = [(entry["event"], entry["scanner_id"]) for entry in log if entry["log_level"] == "error"]
    assert put_off == [("drift-chart-put-off", "a-first-one")]
    (chart,) = store.drift_charts.of_scanner(scan.scanner_id).charts
    assert (chart.looks, chart.finding.kind, chart.calibration_id) == (1, "learning", calibration.id)
    assert (chart.pooled_looks, chart.pooled_cor_column_mm) == (1, pytest.approx(-209.0))


def test_old_deliveries_are_forgotten_each_minute(store, settings, monkeypatch):
    webhook = store.webhooks.create(WebhookAsk(url="https://alarms.mill.example/", events=["*"]))
    store.webhooks.rotate(webhook.id, grace_s=0)
    outbox = store.outbox()
    pending = outbox.pending(webhook.id, store.events.newest_number())
    outbox.note(pending, pending.events[0], DeliveryAttempt(200))
    housekeeping = MillHousekeeping(store, settings, threading.Event())
    housekeeping.once()
    assert len(store.webhooks.deliveries(webhook.id).items) == 1
    with store.database.write() as session:
        session.execute(update(DeliveryRow).values(last_at=store.now() - KEPT - timedelta(seconds=1)))
    housekeeping.once()
    assert len(store.webhooks.deliveries(webhook.id).items) == 1
    a_minute_on = time.monotonic() + 60
    monkeypatch.setattr(time, "monotonic", lambda: a_minute_on)
    housekeeping.once()
    assert store.webhooks.deliveries(webhook.id).items == []


def test_many_batches_go_by_the_rules_of_retention_in_a_round(store, settings, queue, monkeypatch):
    for _ in range(4):
        queue("succeed")
    rules = RetentionRules(events_days=1)
    store.retention.replace(RetentionAsk(**rules.model_dump(), remove_at_most=1_000))
    with store.database.write() as session:
        session.execute(update(EventRow).where(text(REMOVABLE)).values(at=store.now() - timedelta(days=2)))
        session.execute(update(JobRow).values(state=JobState.CANCELLED))
    monkeypatch.setattr(retiring, "EVENTS_A_ROUND", 2)
    monkeypatch.setattr("sawmill_worker.housekeeping.RETENTION_S", 60.0)
    MillHousekeeping(store, settings, threading.Event()).once()
    (went,) = (each.number for each in store.retention.get().removed if each.number)
    assert went == 3, "the newest scan's event stays, and decisions"


def test_trouble_is_logged_and_the_next_round_comes(store, settings, wait_for, monkeypatch):
    away = Away()
    monkeypatch.setattr(store.jobs, "pulses", away)
    stop = threading.Event()
    with capture_logs() as log:
        housekeeping = MillHousekeeping(store, settings, stop)
        housekeeping.start()
        wait_for(lambda: len(away.calls) > 1)
        stop.set()
        housekeeping.join()
    assert [(entry["event"], entry["duty"]) for entry in log] == [("housekeeping-put-off", "take_back_silent")]


def test_an_outage_of_all_duties_is_one_line(store, settings, monkeypatch):
    def away(*_):
        raise StorageUnavailable("the database does not answer: it was stopped")

    housekeeping = MillHousekeeping(store, settings, threading.Event())
    monkeypatch.setattr(store.database, "read", away)
    monkeypatch.setattr(store.database, "write", away)
    monkeypatch.setattr(store, "check_folder", away)
    with capture_logs() as log:
        for _ in range(5):
            housekeeping.once()
    assert [entry["event"] for entry in log] == ["files-not-looked-after", "housekeeping-put-off"]


class Away:
    """Jobs of a database that does not answer at first."""

    def __init__(self) -> None:
        self.calls: list[float] = []

    def __call__(self) -> list[Pulse]:
        self.calls.append(time.monotonic())
        if len(self.calls) == 1:
            raise StorageUnavailable("the database does not answer: away")
        return []


def test_a_log_that_cannot_be_written_stops_nothing(store, settings, wait_for, monkeypatch):
    """Standard error is often a file on the disk that is full."""
    rounds = []

    def stumble():
        rounds.append(1)
        raise StorageUnavailable("the database does not answer: away")

    class Full(io.StringIO):
        def flush(self):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(store.jobs, "pulses", stumble)
    monkeypatch.setattr(sys, "stderr", Full())
    before = structlog.get_config()
    configure_logs("json")
    stop = threading.Event()
    housekeeping = MillHousekeeping(store, settings, stop)
    housekeeping.start()
    try:
        wait_for(lambda: len(rounds) > 2)
    finally:
        stop.set()
        housekeeping.join()
        structlog.configure(**before)
