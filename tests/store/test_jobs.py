"""How jobs are claimed, wait, are lost and end, and the checkpoints that the next attempt finds."""

import pytest
from live_service import race
from pydantic import ValidationError
from results import answer_of, reading

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scans import ScanSpec, ScanState
from sawmill_platform.contracts.attempts import checkpoints_of
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState, Priority
from sawmill_platform.errors import FolderUnavailable, LeaseLost, NotFound
from sawmill_platform.workers.settings import Retries
from sawmill_vocabulary import DataKind, Progress

PASSING = Failure(kind=FailureKind.PASSING, code="attempt-died", detail="the job's process ended with signal 9")
FULL = Failure(kind=FailureKind.PASSING, code="storage-full", detail="the disk is full")
AWAY = Failure(kind=FailureKind.PASSING, code="storage-unavailable", detail="the database does not answer")
OURS = Failure(kind=FailureKind.INTERNAL, code="internal-error", detail="the job stopped on an unexpected KeyError")
AT_ONCE = Retries(loss_wait_s=0, outage_wait_s=0)
READING = reading()
ANSWER = answer_of(kinds.INGEST, READING)


def claim(store):
    taken = store.jobs.claim("test")
    assert taken is not None
    return taken


def take_back_all(store):
    """As an observer that has seen no heartbeat for the time of a lease."""
    return [store.jobs.take_back(pulse, retries=AT_ONCE) for pulse in store.jobs.pulses()]


@pytest.mark.slow
def test_each_job_is_claimed_once_by_processes(store, upload):
    jobs = {upload(store).job_id for _ in range(24)}
    imports = "from sawmill_platform.settings import StorageSettings\nfrom sawmill_store.store import Store"
    program = (
        f"store = Store(StorageSettings.model_validate_json({store.settings.model_dump_json()!r}))\n"
        "while (claimed := store.jobs.claim('racer')) is not None: print(claimed.job_id)"
    )
    taken = race(3, imports, program).split()
    assert (len(taken), set(taken)) == (24, jobs)


@pytest.mark.dialect
def test_the_oldest_job_comes_first_and_knows_its_place(store, upload):
    jobs = [upload(store).job_id for _ in range(3)]
    assert [store.jobs.get(job_id).queue_position for job_id in jobs] == [0, 1, 2]
    assert (list(store.jobs.queued_job_ids()), list(store.jobs.queued_job_ids(older_than_s=60))) == (jobs, [])
    first = claim(store)
    assert first.job_id == jobs[0]
    assert [store.jobs.get(job_id).queue_position for job_id in jobs] == [None, 0, 1]
    assert (first.job.state, first.attempt, first.job.worker) == (JobState.RUNNING, 1, "test")
    assert [claim(store).job_id for _ in range(2)] == jobs[1:]
    assert store.jobs.claim("test") is None


@pytest.mark.dialect
def test_a_job_waits_for_what_it_needs(store, upload, finish):
    scan = upload(store)
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
    reconstruction = store.reconstructions.accept(ReconstructionRequest(scan_id=scan.id, calibration_id=calibration.id))
    chain = [scan.job_id, calibration.job_id, reconstruction.job_id]
    for job_id, next_id in zip(chain, [*chain[1:], None], strict=True):
        assert list(store.jobs.queued_job_ids()) == [job_id]
        held = claim(store)
        assert store.jobs.claim("test") is None
        store.jobs.release(held)
        assert finish(store).job_id == job_id
        assert list(store.jobs.waiting_for(job_id)) == ([next_id] if next_id else [])
    assert store.jobs.claim("test") is None


def test_a_job_may_start_when_what_it_needs_has_failed(store, upload):
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=upload(store).id))
    store.jobs.fail(claim(store), OURS)
    assert claim(store).job_id == calibration.job_id


@pytest.mark.dialect
def test_an_attempt_that_lost_its_lease_changes_nothing(store, upload, finish):
    scan = upload(store)
    late = claim(store)
    output = store.files.folder / "late"
    output.mkdir()
    (output / "result").write_text("late")
    assert [job.state for job in take_back_all(store)] == [JobState.QUEUED]
    finish(store)
    for act in (
        lambda: store.jobs.succeed(late, ANSWER, output),
        lambda: store.jobs.fail(late, OURS),
        lambda: store.jobs.heartbeat(late),
        lambda: store.jobs.cancelled(late),
        lambda: store.jobs.release(late),
    ):
        with pytest.raises(LeaseLost, match=f"attempt 1 no longer holds job '{scan.job_id}'"):
            act()
    assert (store.files.results(late.job.kind, scan.id) / "result").read_text() == "attempt 2"
    assert store.scans.get(scan.id).format == "NXtomo"


def test_what_has_the_wrong_form_or_cannot_be_published_leaves_the_row_as_it_was(store, upload):
    scan = upload(store)
    held = claim(store)
    output = store.files.make_attempt_folder(held.job_id, held.attempt)
    with pytest.raises(ValidationError):
        store.jobs.check_output(kinds.INGEST, READING | {"surprise": 1}, output)
    with pytest.raises(FolderUnavailable, match="publishing a result was given up"):
        store.jobs.succeed(held, ANSWER, store.files.folder / "attempts" / "missing")
    assert store.scans.get(scan.id).state is ScanState.INGESTING
    assert store.jobs.get(held.job_id).state is JobState.RUNNING


@pytest.mark.dialect
def test_a_heartbeat_keeps_the_lease_and_carries_progress_out(store, upload):
    upload(store)
    held = claim(store)
    progress = Progress(fraction=0.5, stage="search", generation=3)
    (seen,) = store.jobs.pulses()
    assert store.jobs.is_silent_still(seen)
    assert store.jobs.heartbeat(held, progress) is False
    assert not store.jobs.is_silent_still(seen)
    assert (store.jobs.take_back(seen), store.jobs.get(held.job_id).progress) == (None, progress)
    store.jobs.heartbeat(held)
    assert store.jobs.get(held.job_id).progress == progress, "no news is not news"


@pytest.mark.dialect
def test_a_lost_worker_s_job_is_tried_three_times(store, upload):
    scan = upload(store)
    states = []
    for attempt in (1, 2, 3):
        assert claim(store).attempt == attempt
        states += [job.state for job in take_back_all(store)]
    assert states == [JobState.QUEUED, JobState.QUEUED, JobState.FAILED]
    job = store.jobs.get(scan.job_id)
    assert (job.failure.kind, job.failure.code) == (FailureKind.PASSING, "worker-lost")
    assert store.scans.get(scan.id).state is ScanState.REFUSED


@pytest.mark.parametrize("outage", [FULL, AWAY])
@pytest.mark.slow
def test_an_outage_is_waited_out_however_long_it_lasts(store, upload, outage):
    scan = upload(store)
    for attempt in range(1, 11):
        held = claim(store)
        assert (held.attempt, held.job.losses, held.job.waiting_for) == (attempt, 0, None)
        assert store.jobs.fail(held, outage, retries=AT_ONCE) is JobState.QUEUED
    waiting = store.jobs.get(scan.job_id)
    assert (waiting.waiting_for, waiting.failure, waiting.losses) == (outage, None, 0)
    for losses in (1, 2):
        assert store.jobs.fail(claim(store), PASSING, retries=AT_ONCE) is JobState.QUEUED
        assert store.jobs.get(scan.job_id).losses == losses
    assert store.jobs.fail(claim(store), PASSING, retries=AT_ONCE) is JobState.FAILED


@pytest.mark.clocked
def test_waits_double_up_to_a_minute_and_are_spread(store, clock, upload):
    scan = upload(store)
    waits = []
    for _ in range(6):
        store.jobs.fail(claim(store), FULL)
        waits.append((store.jobs.get(scan.job_id).not_before - clock.now).total_seconds())
        assert (store.jobs.claim("test"), list(store.jobs.queued_job_ids())) == (None, [])
        with store.database.write() as session:
            session.connection().exec_driver_sql("UPDATE jobs SET not_before_s = 0")
    for waited, nominal in zip(waits, [5, 10, 20, 40, 60, 60], strict=True):
        assert 0.7 * nominal < waited < 1.3 * nominal
    assert len({round(waited / nominal, 3) for waited, nominal in zip(waits, [5, 10, 20, 40, 60, 60], strict=True)}) > 3


def test_a_job_that_waits_is_cancelled_at_once(store, upload):
    scan = upload(store)
    store.jobs.fail(claim(store), FULL)
    ended = store.jobs.request_cancel(scan.job_id)
    assert (ended.state, ended.not_before, ended.waiting_for) == (JobState.CANCELLED, None, None)


@pytest.mark.clocked
@pytest.mark.dialect
def test_a_wait_ends(store, clock, upload):
    upload(store)
    store.jobs.fail(claim(store), PASSING, retries=Retries(loss_wait_s=20.0))
    clock.advance(seconds=10)
    assert store.jobs.claim("test") is None
    clock.advance(seconds=20)
    assert claim(store).job.not_before is None


@pytest.mark.parametrize("kind", [FailureKind.INPUT, FailureKind.INTERNAL])
def test_other_failures_are_final(store, ready_scan, kind):
    asked = store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id))
    failure = OURS.model_copy(update={"kind": kind})
    assert store.jobs.fail(claim(store), failure) is JobState.FAILED
    calibration = store.calibrations.get(asked.id)
    assert (calibration.state, calibration.failure) == ("failed", failure)


ENDS = {
    "cancelled": lambda store, held: store.jobs.cancelled(held) or JobState.CANCELLED,
    "put off": lambda store, held: store.jobs.fail(held, FULL),
    "given back": lambda store, held: store.jobs.release(held),
    "lost": lambda store, _: take_back_all(store)[0].state,
}


@pytest.mark.dialect
@pytest.mark.parametrize("end", ENDS.values(), ids=ENDS)
def test_a_running_job_that_is_to_be_cancelled_hears_of_it_and_is_not_tried_again(store, upload, end):
    scan, held = upload(store), claim(store)
    asked = store.jobs.request_cancel(scan.job_id)
    assert (asked.state, asked.cancel_requested) == (JobState.RUNNING, True)
    assert store.jobs.heartbeat(held) is True
    assert end(store, held) is JobState.CANCELLED
    assert store.jobs.get(scan.job_id).state is JobState.CANCELLED


@pytest.mark.dialect
def test_a_released_job_goes_back_to_its_place_and_that_is_no_loss(store, upload):
    first, second = upload(store), upload(store)
    for attempt in range(1, 6):
        held = claim(store)
        assert (held.job_id, held.attempt) == (first.job_id, attempt)
        store.jobs.release(held)
        assert list(store.jobs.queued_job_ids()) == [first.job_id, second.job_id]
    assert store.jobs.fail(claim(store), PASSING, retries=AT_ONCE) is JobState.QUEUED
    assert store.jobs.get(first.job_id).losses == 1


@pytest.fixture
def example(store, scanner):
    spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS, phantom_id="l-shape")
    return lambda: store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10), priority=Priority.BACKGROUND)


def test_a_background_job_that_was_brought_forward_is_in_nobody_s_way(store, upload, example):
    scan = example()
    held = claim(store)
    assert not store.jobs.is_in_the_way(held)
    upload(store)
    assert store.jobs.is_in_the_way(held)
    store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
    assert not store.jobs.is_in_the_way(held)


def test_a_job_brings_forward_what_it_needs(store, example):
    scans = [example() for _ in range(2)]
    calibrations = [
        store.calibrations.accept(CalibrationRequest(scan_id=scan.id), priority=Priority.BACKGROUND) for scan in scans
    ]
    assert all(store.jobs.get(job.job_id).background for job in [*scans, *calibrations])
    store.reconstructions.accept(ReconstructionRequest(scan_id=scans[1].id, calibration_id=calibrations[1].id))
    forward = {job.job_id for job in [*scans, *calibrations] if not store.jobs.get(job.job_id).background}
    assert forward == {scans[1].job_id, calibrations[1].job_id}
    assert claim(store).job_id == scans[1].job_id


def test_the_fate_of_each_attempt_is_kept(store, upload, finish):
    scan = upload(store)
    claim(store)
    take_back_all(store)
    store.jobs.fail(claim(store), FULL, retries=AT_ONCE)
    store.jobs.release(claim(store))
    finish(store)
    assert [(event.attempt, event.type) for event in store.events.of_job(scan.job_id)] == [
        *[(1, "started"), (1, "lost"), (2, "started"), (2, "postponed")],
        *[(3, "started"), (3, "given-back"), (4, "started"), (4, "succeeded")],
    ]
    lost = store.events.of_job(scan.job_id)[1]
    assert (lost.worker, lost.detail["code"]) == ("test", "worker-lost")


def begin(store, content=None):
    claim = store.jobs.claim("test")
    output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
    if content is not None:
        folder = checkpoints_of(output)
        folder.mkdir()
        (folder / "search").write_text(content)
    return claim, output


def kept(store, claim):
    path = store.files.kept_with(claim.job_id) / "search"
    return path.read_text() if path.is_file() else None


def test_progress_that_is_kept_resets_the_losses(store, upload):
    upload(store)
    for attempt in range(1, 12):
        claim, output = begin(store, f"generation {attempt}")
        assert claim.job.losses <= 2, "it would have failed at the third"
        if attempt % 2 == 0:
            store.jobs.keep(claim, output, ["search"])
            assert store.jobs.get(claim.job_id).losses == 0
            assert kept(store, claim) == f"generation {attempt}"
        assert store.jobs.fail(claim, PASSING, retries=AT_ONCE) is JobState.QUEUED


@pytest.mark.dialect
def test_a_late_attempt_keeps_nothing(store, upload):
    upload(store)
    late, late_output = begin(store, "late")
    store.jobs.release(late)
    newer = store.jobs.claim("newer")
    output = store.files.folder / "newer"
    checkpoints_of(output).mkdir(parents=True)
    (checkpoints_of(output) / "search").write_text("newer")
    store.jobs.keep(newer, output, ["search"])
    with pytest.raises(LeaseLost, match="attempt 1 no longer holds"):
        store.jobs.keep(late, late_output, ["search"])
    assert kept(store, newer) == "newer"


@pytest.mark.parametrize("name", ["../search", "a/b", ".hidden", ""])
def test_names_stay_in_the_folder(store, upload, name):
    upload(store)
    claim, output = begin(store, "some")
    with pytest.raises(NotFound):
        store.jobs.keep(claim, output, [name])


@pytest.mark.parametrize("end", ["succeed", "fail", "cancelled", "cancel while it waits", "lost"])
def test_what_was_kept_goes_when_the_job_ends(store, upload, end):
    upload(store)
    claim, output = begin(store, "some")
    store.jobs.keep(claim, output, ["search"])
    if end == "succeed":
        store.jobs.succeed(claim, answer_of(claim.job.kind, reading()), output)
    elif end == "fail":
        store.jobs.fail(claim, OURS)
    elif end == "cancelled":
        store.jobs.request_cancel(claim.job_id)
        store.jobs.cancelled(claim)
    elif end == "cancel while it waits":
        assert store.jobs.release(claim) is JobState.QUEUED
        assert kept(store, claim) == "some", "a clean stop leaves it"
        store.jobs.request_cancel(claim.job_id)
    else:
        (pulse,) = store.jobs.pulses()
        assert store.jobs.take_back(pulse, retries=Retries(max_losses=1)).state is JobState.FAILED
    assert store.jobs.get(claim.job_id).state.ended
    assert list((store.files.folder / "kept").iterdir()) == []
