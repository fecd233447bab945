"""Checkpoints of a job: taken from the attempt that holds it, there for the next one, gone when the job ends."""

import pytest
from results import answer_of, reading

from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.errors import LeaseLost, NotFound
from sawmill_platform.files.file_store import checkpoints_of
from sawmill_platform.workers.settings import Retries

KILLED = Failure(kind=FailureKind.PASSING, code="attempt-died", detail="the job's process ended with signal 9")
OURS = Failure(kind=FailureKind.INTERNAL, code="internal-error", detail="the job stopped on an unexpected KeyError")
AT_ONCE = Retries(loss_wait_s=0, outage_wait_s=0)


def begin(store, content=None):
    """The next attempt at the only job, its folder, and a checkpoint in it."""
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
        assert store.jobs.fail(claim, KILLED, retries=AT_ONCE) is JobState.QUEUED


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
