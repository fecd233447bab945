"""What happened, as a follower of a scanner reads it."""

import time

import pytest
from emptied_databases import postgresql_alone
from sqlalchemy import event
from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.contracts.uploads import UploadRequest
from sawmill_platform.errors import Damaged
from sawmill_platform.files.upload_stream import AsSent
from sawmill_platform.ledger.events import announce
from sawmill_platform.uploads.upload_store import UploadQuota

pytestmark = [pytest.mark.slow, pytest.mark.clocked]


@pytest.fixture
def reader(store):
    return store.events.reader()


def words(events) -> list[tuple[str, str | None, str | None]]:
    return [(event.type, event.subject, event.group_id) for event in events]


def announced(session: Session, store, scanner_id: str) -> None:
    announce(session, store.database.now(), mill_events.SCANNER_CHANGED, "scanner", scanner_id, group_id=scanner_id)
    session.flush()


@pytest.mark.dialect
def test_a_scan_and_its_calibration_are_announced_from_acceptance_to_activation(store, scanner, upload, finish, reader):
    scan = upload(store)
    finish(store)
    asked = CalibrationRequest(scan_id=scan.id, phantom_id="l-shape", activate=True)
    store.calibrations.accept(asked, identifier="first")
    finish(store)
    store.calibrations.activate("first", "it is active already")
    store.calibrations.accept(asked, identifier="second")
    finish(store)
    store.calibrations.activate("first", "back to it")
    events = reader.read()
    done = ("queued", "started", "succeeded")
    expected = [*((what, "scan") for what in (*done, "scan-ready"))]
    expected += [(what, "calibration") for what in (*done, "calibration-activated")] * 2
    expected += [("calibration-rolled-back", "calibration")]
    assert words(events) == [(*each, scanner.id) for each in expected]
    assert [event.subject_id for event in events] == [scan.id] * 4 + ["first"] * 4 + ["second"] * 4 + ["first"]
    assert events[-1].detail == {"reason": "back to it"}
    # Attempts alone are a job's history.
    assert [event.type for event in store.events.of_job(events[4].job_id)] == ["started", "succeeded"]
    assert reader.read() == []


def test_what_is_refused_cancelled_and_deleted_is_announced(store, upload, clock, reader, refuse):
    refused = upload(store)
    clock.advance(seconds=1)
    cancelled = upload(store)
    refuse("the file holds no stack")
    store.jobs.request_cancel(cancelled.job_id)
    store.scans.delete(refused.id)
    assert [(event.type, event.subject_id, (event.detail or {}).get("reason")) for event in reader.read()[3:]] == [
        ("failed", refused.id, None),
        ("scan-refused", refused.id, "the file holds no stack"),
        ("cancelled", cancelled.id, None),
        ("scan-refused", cancelled.id, "its job was cancelled before it ended"),
        ("scan-deleted", refused.id, None),
    ]


def test_scanners_and_schedules_that_change_and_due_times_that_pass_are_announced(store, scanner, clock, reader):
    store.scanners.update(scanner.id, scanner.model_copy(update={"name": "Line 3"}))
    spec = ScheduleSpec(scanner_id=scanner.id, cron="30 5 * * *")
    schedule = store.schedules.create(spec)
    clock.advance(days=2)
    store.schedules.run_due()
    store.schedules.update(schedule.id, spec)
    store.schedules.delete(schedule.id)
    store.scanners.delete(scanner.id)
    events = reader.read()
    assert [event.type for event in events] == [
        *("scanner-changed", "schedule-created", "schedule-missed", "schedule-changed", "schedule-deleted"),
        "scanner-deleted",
    ]
    assert events[2].detail == {
        "due_at": "2026-03-02T05:30:00+00:00",
        "reason": "nothing ran schedules then; later there was no new scan of a phantom",
    }
    assert {event.group_id for event in events} == {scanner.id}


def test_uploads_that_are_refused_or_expire_are_announced_with_the_reason(store, clock, reader):
    quota = UploadQuota(5, 100, 100)
    asks = (UploadRequest(size_bytes=4, sha256=sha256) for sha256 in ("0" * 64, None))
    other, stands_still = (store.uploads.create(ask, quota) for ask in asks)
    part = store.uploads.begin_part(other.id, 0)
    part.take(AsSent(), b"scan", commits=True)
    part.finish(AsSent())
    with pytest.raises(Damaged):
        part.complete()
    part.close()
    clock.advance(days=2)
    store.uploads.remove_expired()
    assert [(event.type, event.subject_id, event.detail) for event in reader.read()[2:]] == [
        ("upload-deleted", other.id, {"reason": "the file that came has another sha256"}),
        ("upload-deleted", stands_still.id, {"reason": "expired"}),
    ]


def test_a_job_that_runs_is_asked_to_stop_and_that_is_no_fate_of_its_attempt(store, upload, reader):
    running = upload(store).job_id
    store.jobs.claim("test")
    for _ in range(2):
        store.jobs.request_cancel(running)
    asked = reader.read()[2:]
    assert [(event.type, event.subject, event.job_id) for event in asked] == [("cancel-requested", "scan", running)]
    assert [event.type for event in store.events.of_job(running)] == ["started"]


@pytest.mark.dialect
def test_a_change_that_fails_is_not_announced(store, reader):
    key = store.keys.create(KeyRequest(name="gate", scope=Scope.READ))
    event.listen(store.database.engine, "commit", lambda _: 1 / 0)
    for change in (
        lambda: store.keys.rotate(key.id),
        lambda: store.keys.create(KeyRequest(name="other", scope=Scope.READ)),
    ):
        with pytest.raises(ZeroDivisionError):
            change()
    assert words(reader.read()) == [("key-created", "key", None)]


@pytest.mark.dialect
def test_events_behind_a_number_are_those_of_one_scanner_or_of_all(store, scanner, reader):
    other = store.scanners.create(scanner.model_copy(update={"name": "Line 9"}))
    store.scanners.delete(other.id)
    number = reader.number
    every = store.events.following(number)
    assert words(every) == [("scanner-created", "scanner", other.id), ("scanner-deleted", "scanner", other.id)]
    assert store.events.following(number, group_id=scanner.id) == []
    assert store.events.following(number, through=every[0].number) == every[:1]
    assert store.events.following(every[0].number, group_id=other.id) == every[1:]


def write_pair(store, reader) -> tuple[Session, list[str]]:
    """A transaction that holds a number, beside one that took a later number and is committed; and what is read."""
    late = Session(store.database.engine)
    announced(late, store, "late")
    with store.database.write() as session:
        announced(session, store, "early")
    return late, [event.group_id for event in reader.read()]


def read_until(reader, wanted: list[str]) -> list[str]:
    read = []
    for _ in range(1200):
        read += [event.group_id for event in reader.read()]
        if len(read) >= len(wanted):
            break
        time.sleep(0.05)
    return read


@postgresql_alone
def test_a_number_that_is_committed_late_is_waited_for(store, reader):
    late, read = write_pair(store, reader)
    assert read == []
    # Whoever comes now stands before the gap too.
    newcomer = store.events.reader()
    assert newcomer.number == reader.number
    time.sleep(0.7)
    assert reader.read() == []
    late.commit()
    late.close()
    for each in (reader, newcomer):
        assert read_until(each, ["late", "early"]) == ["late", "early"]


@postgresql_alone
def test_a_number_that_is_never_committed_is_passed_by(store, reader):
    late, read = write_pair(store, reader)
    assert read == []
    late.rollback()
    late.close()
    assert read_until(reader, ["early"]) == ["early"]
    # The gap is of the last minute, but no transaction is open: nothing is missing.
    assert store.events.reader().number == reader.number


def test_a_job_s_numbers_are_those_of_its_newest_event_and_of_its_end(store, upload, finish):
    scan = upload(store)
    (queued,) = [event.number for event in store.events.following(0) if event.job_id == scan.job_id]
    assert store.events.numbers_of_job(scan.job_id) == (queued, None)
    finish(store)
    _, started, ended, *_ = [event.number for event in store.events.following(0) if event.job_id == scan.job_id]
    assert store.events.numbers_of_job(scan.job_id) == (started, ended)
    other = upload(store)
    assert store.events.numbers_of_job(other.job_id).end is None
    store.jobs.request_cancel(other.job_id)
    latest, ended = store.events.numbers_of_job(other.job_id)
    assert queued < latest < ended
    assert store.events.numbers_of_job("nothing") == (0, None)
