"""What rules of retention remove, and what never goes: rows, jobs, files, and the number that is shown before."""

import errno
import os
import signal
import threading
from datetime import timedelta

import pytest
from emptied_databases import postgresql_alone, sqlite_alone
from machine_faults import at_call, refusing
from sqlalchemy import event

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.retention import RetentionKind, RetentionRequest, RetentionRules
from sawmill_contracts.scans import ScanState
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.tables import JobRow
from sawmill_platform.errors import Conflict, NotFound
from sawmill_store.mill_tables import ReconstructionRow
from sawmill_store.retention.retention_store import RetentionKeeper
from sawmill_store.store import Store

# All kinds, after a day; what protects needs no rule of its own.
ALL = RetentionRules(**dict.fromkeys(RetentionRules.model_fields, 1))
# Too few views for a drift check.
UNFIT = {"shape": {"views": 2, "rows": 1, "detector": 768}}


@pytest.fixture
def mill(store, clock):
    store.database.now = clock
    return store


def log(store, upload, finish, **reading):
    store.database.now.advance(seconds=1)
    scan = upload(store, phantom_id=None)
    finish(store, **reading)
    return scan.id


def calibrated(store, upload, finish, **ask):
    store.database.now.advance(seconds=1)
    scan = upload(store)
    finish(store)
    accepted = store.calibrations.accept(CalibrationRequest(scan_id=scan.id, **ask))
    finish(store)
    return scan.id, accepted.id


def put(store, rules):
    ask = RetentionRequest(**rules.model_dump(), remove_at_most=store.retention.preview(rules).number)
    return store.retention.replace(ask)


def carried_out(store):
    """What a keeper removes that starts now, by kind."""
    keeper = RetentionKeeper(store.database, store.files)
    gone: dict[RetentionKind, int] = {}
    for _ in range(1000):
        removed = keeper.remove_some()
        if removed is None:
            return gone
        gone[removed.kind] = gone.get(removed.kind, 0) + removed.number
    raise AssertionError(gone)


def ids(store):
    return {scan.id for scan in store.scans.page(limit=200).items}


@sqlite_alone
def test_the_old_go_with_their_jobs_and_files_and_are_counted(mill, clock, upload, finish):
    old = log(mill, upload, finish)
    clock.advance(days=10)
    young, newest = log(mill, upload, finish), log(mill, upload, finish)
    clock.advance(days=5)
    job_id, folder = mill.scans.get(old).job_id, mill.files.results(kinds.INGEST, old)
    number = mill.events.newest_number()
    put(mill, RetentionRules(log_scans_days=14))
    assert carried_out(mill) == {RetentionKind.LOG_SCANS: 1}
    assert ids(mill) == {young, newest}
    with pytest.raises(NotFound):
        mill.jobs.get(job_id)
    assert not folder.exists()
    assert not mill.files.upload(kinds.INGEST, old).parent.exists()
    changed, removed = mill.events.following(number)
    assert (changed.type, changed.subject) == ("retention-changed", "retention")
    assert (removed.type, removed.subject_id, removed.detail["number"]) == ("retention-removed", "log-scans", 1)
    [entry] = [each for each in mill.retention.get().removed if each.number]
    assert entry.kind == "log-scans"
    assert mill.audit.page().items[0].detail == {"log_scans_days": [None, 14]}


@pytest.fixture
def full_mill(mill, clock, scanner, upload, finish):
    """One of each thing that stays, and why; everything is old."""
    mill.schedules.create(ScheduleSpec(scanner_id=scanner.id, kind="check-drift", cron="0 5 * * *"))
    _, ages_ago = calibrated(mill, upload, finish)
    mill.calibrations.activate(ages_ago, "the first")
    before_scan, before = calibrated(mill, upload, finish)
    mill.calibrations.activate(before, "the second")
    active_scan, active = calibrated(mill, upload, finish)
    mill.calibrations.activate(active, "the third")
    clock.advance(hours=1)
    _, used = calibrated(mill, upload, finish)
    earlier_log, drift_log = log(mill, upload, finish), log(mill, upload, finish)
    drift = mill.drifts.accept(DriftRequest(scan_id=drift_log, calibration_id=used)).id
    finish(mill)
    clock.advance(hours=1)
    newest_scan, of_newest = calibrated(mill, upload, finish)
    awaited = log(mill, upload, finish)  # the drift checks' next
    clock.advance(minutes=1)
    newest_log = log(mill, upload, finish, **UNFIT)
    waits = upload(mill, phantom_id=None).id
    waiting = mill.reconstructions.accept(ReconstructionRequest(scan_id=drift_log, calibration_id=active)).id
    awaiting = mill.calibrations.accept(CalibrationRequest(scan_id=before_scan)).id
    unchecked = mill.drifts.accept(DriftRequest(scan_id=earlier_log, calibration_id=active)).id
    clock.advance(days=400)
    # By kind, for each reason the objects that are kept for it: each reason has one that no other reason keeps.
    return {
        RetentionKind.LOG_SCANS: ({newest_log}, {awaited}, {waits, drift_log, earlier_log}),
        RetentionKind.PHANTOM_SCANS: ({before_scan, active_scan}, {newest_scan}),
        RetentionKind.CALIBRATIONS: ({ages_ago}, {before, active}, {used, active}, {of_newest}, {awaiting}),
        RetentionKind.DRIFTS: ({drift}, {unchecked}),
        RetentionKind.RECONSTRUCTIONS: ({waiting},),
    }


@pytest.mark.slow
@pytest.mark.dialect
def test_what_something_needs_stays_and_nothing_else_does(mill, full_mill):
    kept = {kind: set().union(*by_reason) for kind, by_reason in full_mill.items()}
    stays = {each.kind: each.stays for each in mill.retention.preview(ALL).kinds}
    assert {kind: stays[kind] for kind in kept} == {kind: len(names) for kind, names in kept.items()}
    assert (stays[RetentionKind.INSPECTIONS], stays[RetentionKind.EVENTS]) == (0, 1)
    put(mill, ALL)
    carried_out(mill)
    assert ids(mill) == kept[RetentionKind.LOG_SCANS] | kept[RetentionKind.PHANTOM_SCANS]
    assert {each.id for each in mill.calibrations.page().items} == kept[RetentionKind.CALIBRATIONS]
    assert {each.id for each in mill.drifts.page().items} == kept[RetentionKind.DRIFTS]
    assert {each.id for each in mill.reconstructions.page().items} == kept[RetentionKind.RECONSTRUCTIONS]
    assert mill.jobs.claim("test") is not None, "what waits can still be done"


@sqlite_alone
def test_calibrations_go_and_schedules_keep_their_runs(mill, clock, scanner, upload, finish):
    schedule = mill.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="0 5 * * *"))
    scan = upload(mill)
    finish(mill)
    clock.advance(days=1)
    [run] = mill.schedules.run_due()
    finish(mill)
    clock.advance(days=1)
    assert run.calibration_id is not None
    put(mill, RetentionRules(calibrations_days=1, phantom_scans_days=1))
    clock.advance(days=2)
    assert carried_out(mill) == {}, "a schedule knows by it that the scan was used"
    upload(mill)
    finish(mill)
    assert carried_out(mill) == {RetentionKind.PHANTOM_SCANS: 1, RetentionKind.CALIBRATIONS: 1}
    assert mill.jobs.get(scan.job_id).state is JobState.SUCCEEDED, "an alarm knows by it when a phantom was scanned"
    assert [(each.outcome, each.calibration_id) for each in mill.schedules.runs(schedule.id)] == [("queued", None)]


@sqlite_alone
def test_inspections_go_after_their_jobs(mill, clock):
    waits = mill.inspections.accept_file(InspectionOptions(), mill.files.receive([b"file"], max_bytes=10))
    clock.advance(days=3)
    put(mill, RetentionRules(inspections_days=1))
    assert RetentionKind.INSPECTIONS not in carried_out(mill)
    mill.jobs.request_cancel(waits.job_id)
    assert carried_out(mill)[RetentionKind.INSPECTIONS] == 1
    assert mill.inspections.page().items == []
    assert not mill.files.upload(kinds.INSPECT, waits.id).exists()


@pytest.mark.dialect
def test_old_events_go_but_for_the_last_scans_and_numbers_go_on(mill, clock, upload, finish):
    clock.advance(days=-60)
    log(mill, upload, finish)
    came = mill.events.following(0)[-5:]
    clock.advance(days=60)
    put(mill, RetentionRules(events_days=30))
    before = mill.events.newest_number()
    shown = mill.retention.preview(RetentionRules(events_days=30)).kinds[-1]
    assert shown.stays == 1
    assert carried_out(mill) == {RetentionKind.EVENTS: shown.number}
    left = mill.events.following(0)
    old = [each for each in left if each.at < clock() - timedelta(days=30)]
    assert [(each.type, each.subject) for each in old] == [("queued", "scan")]
    assert old[0] in came
    assert left[-1].number == before + 1, "the newest stays, so that numbers go on from it"
    clock.advance(days=30)
    carried_out(mill)
    assert mill.events.newest_number() > before


@sqlite_alone
def test_what_becomes_too_old_within_an_hour_is_confirmed_too(mill, clock, upload, finish):
    for _ in range(4):
        log(mill, upload, finish)
        clock.advance(minutes=25)
    clock.advance(days=1, minutes=-100)
    shown = mill.retention.preview(RetentionRules(log_scans_days=1))
    assert (shown.number, shown.at) == (3, clock() + timedelta(hours=1))
    clock.advance(minutes=30)
    ask = RetentionRequest(log_scans_days=1, remove_at_most=shown.number)
    assert mill.retention.replace(ask).rules.log_scans_days == 1
    assert carried_out(mill) == {RetentionKind.LOG_SCANS: 2}


@sqlite_alone
def test_rules_hold_only_if_they_remove_no_more_than_was_confirmed(mill, clock, upload, finish):
    log(mill, upload, finish)
    log(mill, upload, finish)
    rules = RetentionRules(log_scans_days=1)
    assert mill.retention.preview(rules).number == 0
    clock.advance(days=3)
    assert carried_out(mill) == {}, "without rules nothing goes"
    shown = mill.retention.preview(rules).number
    assert shown == 1, "the newest stays"
    with pytest.raises(Conflict, match=r"would remove 1 \(1 log-scans\), and 0 are confirmed: nothing was changed"):
        mill.retention.replace(RetentionRequest(log_scans_days=1))
    log(mill, upload, finish)  # of the two before, the newer one is not the newest any more
    with pytest.raises(Conflict, match=r"would remove 2 \(2 log-scans\), and 1 are confirmed"):
        mill.retention.replace(RetentionRequest(log_scans_days=1, remove_at_most=shown))
    assert mill.retention.get().changed_at is None
    mill.retention.replace(RetentionRequest(log_scans_days=1, remove_at_most=2))
    assert mill.retention.get().rules == rules
    mill.retention.replace(RetentionRequest())
    assert carried_out(mill) == {}, "rules that remove nothing need no number, and hold at once"


def once_chosen(mill, happen):
    """Let something happen just after the rows of scans that may go were chosen, once."""
    waiting = [happen]

    def look(*given):
        if waiting and "FROM scans" in given[2] and "ORDER BY scans.created_at" in given[2]:
            waiting.pop()()

    event.listen(mill.database.engine, "after_cursor_execute", look)


@sqlite_alone
def test_rules_that_change_end_a_round_that_has_begun(mill, clock, upload, finish):
    logs = {log(mill, upload, finish) for _ in range(3)}
    clock.advance(days=3)
    put(mill, RetentionRules(log_scans_days=1))
    once_chosen(mill, lambda: mill.retention.replace(RetentionRequest()))
    assert carried_out(mill) == {}
    assert ids(mill) == logs


@sqlite_alone
def test_what_is_activated_after_it_was_chosen_stays_with_its_scan(mill, clock, upload, finish):
    scan_id, chosen_one = calibrated(mill, upload, finish)
    for _ in range(2):
        calibrated(mill, upload, finish)
    clock.advance(days=3)
    put(mill, RetentionRules(calibrations_days=1, phantom_scans_days=1))
    once_chosen(mill, lambda: mill.calibrations.activate(chosen_one, "back to it"))
    assert carried_out(mill) == {RetentionKind.PHANTOM_SCANS: 1, RetentionKind.CALIBRATIONS: 1}
    assert mill.scans.get(scan_id).state is ScanState.READY
    assert mill.calibrations.get(chosen_one).state == JobState.SUCCEEDED


@postgresql_alone
def test_an_activation_and_a_removal_at_one_time_wait_for_one_another(mill, settings, clock, upload, finish):
    _, activated = calibrated(mill, upload, finish)
    _, removed = calibrated(mill, upload, finish)
    calibrated(mill, upload, finish)
    clock.advance(days=3)
    put(mill, RetentionRules(calibrations_days=1))
    other = Store(settings, clock=clock)
    about_to_commit, goes_on = threading.Event(), threading.Event()

    def linger(_):
        about_to_commit.set()
        goes_on.wait(60.0)

    event.listen(other.database.engine, "commit", linger, once=True)
    activating = threading.Thread(target=other.calibrations.activate, args=(activated, "at this moment"))
    activating.start()
    about_to_commit.wait(60.0)
    threading.Timer(0.2, goes_on.set).start()
    assert carried_out(mill) == {RetentionKind.CALIBRATIONS: 1}
    activating.join()
    assert mill.calibrations.get(activated).state == JobState.SUCCEEDED
    # The other way round: it is gone when the activation gets its turn.
    with mill.database.write() as session:
        assert session.get(JobRow, "none") is None
    with pytest.raises(NotFound):
        other.calibrations.activate(removed, "too late")
    other.close()


@postgresql_alone
def test_what_is_asked_of_a_scan_that_is_about_to_go_keeps_it(mill, settings, clock, upload, finish):
    scan_id, calibration_id = calibrated(mill, upload, finish)
    calibrated(mill, upload, finish)
    clock.advance(days=3)
    put(mill, RetentionRules(phantom_scans_days=1))
    other = Store(settings, clock=clock)
    has_locked, goes_on = threading.Event(), threading.Event()

    def linger(*_):
        has_locked.set()
        goes_on.wait(60.0)

    event.listen(ReconstructionRow, "before_insert", linger, once=True)
    asked = []
    ask = ReconstructionRequest(scan_id=scan_id, calibration_id=calibration_id)
    asking = threading.Thread(target=lambda: asked.append(other.reconstructions.accept(ask)))
    asking.start()
    has_locked.wait(60.0)

    def go_on_soon(*given):
        if "FOR " in given[2] and "FROM scanners" in given[2]:  # the first of the locks
            threading.Timer(0.5, goes_on.set).start()

    event.listen(mill.database.engine, "before_cursor_execute", go_on_soon)
    assert carried_out(mill) == {}
    asking.join()
    assert [each.scan_id for each in asked] == [scan_id]
    assert scan_id in ids(mill)
    other.close()


@sqlite_alone
def test_a_leap_of_the_clock_removes_nothing_until_somebody_confirms(mill, clock, upload, finish):
    logs = {log(mill, upload, finish) for _ in range(3)}
    rules = RetentionRules(log_scans_days=60)
    put(mill, rules)
    clock.advance(days=25)
    assert carried_out(mill) == {}
    last = clock()
    clock.advance(days=365)
    assert carried_out(mill) == {}
    assert ids(mill) == logs
    assert mill.retention.get().days_wait_since == last
    clock.advance(days=-364)
    carried_out(mill)
    assert mill.retention.get().days_wait_since is None, "the clock is right again"
    clock.advance(days=365)
    put(mill, rules)
    assert carried_out(mill) == {RetentionKind.LOG_SCANS: 2}


@sqlite_alone
def test_a_kill_between_rows_and_files_leaves_what_leftovers_remove(mill, settings, clock, upload, finish):
    old = log(mill, upload, finish)
    kept = log(mill, upload, finish)
    clock.advance(days=3)
    put(mill, RetentionRules(log_scans_days=1))
    child = os.fork()
    if not child:
        own = Store(settings, clock=clock)
        with at_call("os.rename", lambda _: os.kill(os.getpid(), signal.SIGKILL), below=own.files.folder):
            RetentionKeeper(own.database, own.files).remove_some()
        os.abort()
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    places = [mill.files.results(kinds.INGEST, old), mill.files.upload(kinds.INGEST, old).parent]
    assert ids(mill) == {kept}
    assert all(place.exists() for place in places)
    assert mill.retention.get().removed[0].number == 1
    now_s = [0.0]
    leftovers = mill.leftovers(grace_s=1.0, now_s=lambda: now_s[0])
    leftovers.remove_some()
    now_s[0] = 2.0
    assert sorted(leftovers.remove_some()) == sorted(places)
    assert carried_out(mill) == {}


@sqlite_alone
def test_a_file_that_cannot_be_removed_keeps_no_other(mill, clock, upload, finish):
    old = [log(mill, upload, finish) for _ in range(3)]
    clock.advance(days=3)
    put(mill, RetentionRules(log_scans_days=1))
    stuck = mill.files.results(kinds.INGEST, old[0])
    with at_call("os.rename", refusing(errno.EACCES), below=stuck), pytest.raises(PermissionError):
        carried_out(mill)
    assert ids(mill) == {old[2]}
    assert not mill.files.results(kinds.INGEST, old[1]).exists()
