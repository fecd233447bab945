"""A scanner's history: who did what to it and why, on both databases, and what of it outlasts what it is about."""

from datetime import timedelta

import pytest
from sqlalchemy import delete

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.errors import Conflict, Invalid, NotFound
from sawmill_platform.ledger.events import Actor, acting_as
from sawmill_store.mill_tables import ActivationRow, CalibrationRow

pytestmark = pytest.mark.clocked

ANNA, BEN = Actor("anna", "0a"), Actor("ben", "0b")


@pytest.fixture
def calibrated(store, ready_scan, finish, clock):
    clock.advance(hours=1)
    with acting_as(ANNA):
        store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id), identifier="first")
    finish(store)
    with acting_as(BEN):
        store.calibrations.activate("first", "checked by hand")


@pytest.mark.usefixtures("calibrated")
def test_each_entry_names_who_and_why(store, scanner, ready_scan, finish, clock, refuse):
    since = clock.now + timedelta(seconds=1)
    clock.advance(hours=1)
    with acting_as(ANNA):
        store.drifts.accept(DriftRequest(scan_id=ready_scan.id))
        finish(store, within_tolerance=False, reason="the turntable moved")
        store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id), identifier="failing")
        refuse("no phantom is seen")
        store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id), identifier="stopped")
    running = store.jobs.claim("test")
    with acting_as(BEN):
        store.jobs.request_cancel(running.job_id)
        spec = {name: getattr(scanner, name) for name in ScannerSpec.model_fields}
        limits = {"alarms": {"quiet_after_hours": 24}, "name": "Line 3"}
        store.scanners.update(scanner.id, ScannerSpec.model_validate(spec | limits))
    store.jobs.cancelled(running)
    clock.advance(hours=30)
    store.alarms.check()
    schedule = store.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="0 * * * *", kind="check-drift"))
    clock.advance(hours=1)
    store.schedules.run_due()
    by_schedule, renamed = f"schedule {schedule.id}", 'name: "Line 3", was "Line 2"'
    entries = store.history.page(scanner.id, since=since).items[::-1]
    assert [(entry.kind.value, entry.type, entry.who, entry.why) for entry in entries] == [
        ("drift-check", "succeeded", "anna", "the turntable moved"),
        ("calibration", "failed", "anna", "no phantom is seen"),
        ("settings", "scanner-changed", "ben", f"{renamed}; alarms.quiet_after_hours: 24.0, was null"),
        ("calibration", "cancelled", "ben", None),
        ("alarm", "alarm-opened", "the service", "no scan came after 2026-03-02 05:00 UTC for 24 hours"),
        ("schedule", "schedule-created", "the service", None),
        ("schedule", "schedule-missed", by_schedule, "there was no new scan of a log that a drift check could use"),
    ]
    alarm = store.history.page(scanner.id, kind=HistoryKind.ALARM).items[0]
    opened_at = clock.now - timedelta(hours=1)
    assert (alarm.alarm, alarm.at, alarm.link) == ("scanner-quiet", opened_at, f"/v1/scanners/{scanner.id}")
    marks = [(mark.kind, mark.at) for mark in store.history.marks(scanner.id, since - timedelta(hours=2))]
    assert marks == [("activation", since - timedelta(seconds=1)), ("alarm", opened_at)]


@pytest.mark.dialect
@pytest.mark.usefixtures("calibrated")
def test_pages_batches_and_bounds_leave_nothing_out(store, scanner, ready_scan, finish, clock):
    store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id), identifier="second")
    finish(store)
    # Several of one time.
    for number in range(6):
        store.calibrations.activate(("second", "first")[number % 2], f"number {number}")
    clock.advance(days=1)
    store.calibrations.activate("second", "a day later")
    every = store.history.page(scanner.id).items
    assert len(every) == 11
    paged, after = [], None
    while len(paged) < len(every):
        page = store.history.page(scanner.id, after=after, limit=3)
        paged, after = [*paged, *page.items], page.next
    assert (paged, after) == (every, None)
    assert [entry for batch in store.history.all(scanner.id) for entry in batch] == every[::-1]
    activations = store.history.page(scanner.id, kind=HistoryKind.ACTIVATION).items
    assert activations == [entry for entry in every if entry.kind is HistoryKind.ACTIVATION]
    assert store.history.page(scanner.id, since=clock.now).items == every[:1]
    assert store.history.page(scanner.id, until=clock.now).items == every[1:]
    for cursor in ("x", "1.x", "12", "1.99999999999999999999", every[0].subject_id):
        with pytest.raises(Invalid, match="after must be the next"):
            store.history.page(scanner.id, after=cursor)
    for ask in (store.history.page, store.history.all):
        with pytest.raises(NotFound, match="no scanner 'other'"):
            ask("other")


@pytest.mark.usefixtures("calibrated")
def test_what_it_measured_stays_when_a_calibration_goes(store, scanner, ready_scan):
    before = store.history.page(scanner.id).items
    with store.database.write() as session:
        session.execute(delete(ActivationRow))
        session.execute(delete(CalibrationRow))
    assert store.history.page(scanner.id).items == [
        entry if entry.subject == "scanner" else entry.model_copy(update={"link": None}) for entry in before
    ]
    store.scans.delete(ready_scan.id)
    with pytest.raises(Conflict, match="is used by 1 measurements; a used scanner stays"):
        store.scanners.delete(scanner.id)


def test_the_history_of_an_unused_scanner_goes_with_it(store, scanner):
    store.scanners.delete(scanner.id)
    with pytest.raises(NotFound):
        store.history.page(scanner.id)
    again = store.scanners.create(ScannerSpec(name="Line 9", constants=scanner.constants), scanner_id=scanner.id)
    assert [entry.why for entry in store.history.page(again.id).items] == [None]
