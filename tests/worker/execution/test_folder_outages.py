"""A data folder that goes, comes back, lacks a file or becomes read-only: jobs wait, and no attempt is lost."""

import errno
import shutil

import pytest
from live_service import wait_until
from machine_faults import at_call, refusing
from structlog.testing import capture_logs

from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.workers.poller import run_worker
from sawmill_worker.housekeeping import MillHousekeeping

pytestmark = pytest.mark.slow


@pytest.fixture
def storage(storage, empty_data, tmp_path):
    """With the database elsewhere, as on a server: the folder alone can go."""
    shutil.copy(empty_data / "sawmill.db", tmp_path / "apart.db")
    return storage.model_copy(update={"database_url": f"sqlite:///{tmp_path}/apart.db"})


def test_a_worker_waits_for_its_folder_says_so_once_and_does_the_job_then(
    store, settings, program, stop, queue, in_background
):
    job, folder, aside = queue("succeed"), store.files.folder, store.files.folder.with_name("mounted elsewhere")
    folder.rename(aside)
    folder.mkdir()
    with capture_logs() as log:

        def said():
            events = [entry["event"] for entry in log]
            return [events.count(event) for event in ("claim-put-off", "files-not-looked-after")]

        outcome = in_background(run_worker, program, store, settings, stop)
        wait_until(lambda: all(said()))
        assert (list(folder.iterdir()), store.jobs.get(job.id).state) == ([], JobState.QUEUED)
        folder.rmdir()
        aside.rename(folder)
        wait_until(lambda: store.jobs.get(job.id).state is JobState.SUCCEEDED or outcome.done())
        stop.set()
        outcome.result(timeout=60)
        assert said() == [1, 1]
    ended = store.jobs.get(job.id)
    assert (ended.state, ended.attempt, ended.losses) == (JobState.SUCCEEDED, 1, 0)


def waits(store, runner, job):
    """Do a job that then waits for the data folder, without a loss; give the detail and the attempts that it had."""
    assert runner.run_next() is JobState.QUEUED
    waiting = store.jobs.get(job.id)
    assert (waiting.waiting_for.code, waiting.losses) == ("storage-unavailable", 0)
    return waiting.waiting_for.detail, waiting.attempt


def test_a_job_whose_file_is_missing_waits_until_it_is_back(store, runner, queue):
    job = queue("succeed")
    file = store.files.upload(job.kind, job.subject_id)
    file.rename(file.with_name("aside"))
    assert f"lacks the file 'uploads/scans/{job.subject_id}/original'" in waits(store, runner, job)[0]
    file.with_name("aside").rename(file)
    assert runner.run_next() is JobState.SUCCEEDED


def test_housekeeping_removes_nothing_in_a_folder_of_another_service(store, settings, stop):
    identity, theirs = store.files.folder / "identity", store.files.folder / "scans" / "theirs"
    ours = identity.read_text()
    theirs.mkdir()
    housekeeping = MillHousekeeping(store, settings.model_copy(update={"leftovers_s": 0.0}), stop)
    for content, stays in (("of another service", True), (ours, False)):
        identity.write_text(content)
        for _ in range(3):
            housekeeping.once()
        assert theirs.exists() is stays


@pytest.mark.usefixtures("read_only_disk")
def test_housekeeping_says_once_that_a_disk_is_read_only(store, settings, stop):
    housekeeping = MillHousekeeping(store, settings, stop)
    with capture_logs() as log:
        for _ in range(3):
            housekeeping.once()
    assert [entry["event"] for entry in log] == ["files-not-looked-after"]


@pytest.mark.parametrize(("call", "said"), [("os.mkdir", 0), ("os.rename", 1)])
def test_a_disk_that_becomes_read_only_costs_no_loss(store, runner, stop, queue, call, said):
    """What was computed waits while the disk can be read, which is said once; a stopping worker gives it back."""
    refuse, asked = refusing(errno.EROFS), []

    def refuse_and_stop_at_last(path):
        asked.append(path)
        if len(asked) == 3:
            stop.set()
        refuse(path)

    job = queue("succeed")
    with capture_logs() as log, at_call(call, refuse_and_stop_at_last, below=store.files.folder):
        assert waits(store, runner, job)[1] == 1
    assert (len(asked) >= 3, [entry["event"] for entry in log].count("end-put-off")) == (bool(said), said)
    stop.clear()
    assert runner.run_next() is JobState.SUCCEEDED


class Away(Jobs):
    """Jobs whose data folder goes at a moment, and leaves an empty one."""

    folder = moment = None

    def go(self, moment):
        if moment == self.moment:
            self.folder.rename(self.folder.with_name("mounted elsewhere"))
            self.folder.mkdir()

    def claim(self, *arguments):
        claim = super().claim(*arguments)
        self.go("after the claim")
        return claim

    def handed_over(self, job_id):
        self.go("under the supervisor")
        (self.folder / "identity").stat()
        return super().handed_over(job_id)

    def check_output(self, *arguments):
        self.go("before the check")
        return super().check_output(*arguments)


@pytest.mark.parametrize("when", ["after the claim", "under the supervisor", "before the check"])
def test_a_folder_that_goes_costs_no_loss(store, start, store_with, runner, queue, when):
    class AwayThen(Away):
        folder, moment = store.files.folder, when

    job, folder = queue("succeed"), store.files.folder
    waits(store, start(on=store_with(AwayThen)), job)
    folder.rmdir()
    folder.with_name("mounted elsewhere").rename(folder)
    assert runner.run_next() is JobState.SUCCEEDED


@pytest.mark.parametrize("behaviour", ["miss-its-folder", "miss-its-file"])
def test_a_folder_that_was_away_for_a_moment_costs_no_loss(store, runner, queue, behaviour):
    waits(store, runner, queue(behaviour))
    assert runner.run_next() is JobState.SUCCEEDED


def test_another_file_that_a_job_misses_is_a_defect(store, runner, queue):
    job = queue("miss-something-else")
    assert runner.run_next() is JobState.FAILED
    assert store.jobs.get(job.id).failure.code == "internal-error"
