"""A data folder that goes, comes back, lacks a file or becomes read-only: jobs wait, and no attempt is lost."""

import errno
import os
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.errors import InvalidOutput
from sawmill_platform.workers.poller import run_worker
from sawmill_worker.housekeeping import MillHousekeeping
from sawmill_worker.program import MILL

pytestmark = pytest.mark.slow


@pytest.fixture
def storage(storage, empty_data, tmp_path):
    """With the database elsewhere, as on a server: the folder alone can go."""
    shutil.copy(empty_data / "sawmill.db", tmp_path / "apart.db")
    return storage.model_copy(update={"database_url": f"sqlite:///{tmp_path}/apart.db"})


def test_a_worker_waits_for_its_folder_says_so_once_and_does_the_job_then(store, settings, command, queue, wait_for):
    job, stop = queue("succeed"), threading.Event()
    folder, aside = store.files.folder, store.files.folder.with_name("mounted elsewhere")
    folder.rename(aside)
    folder.mkdir()
    with capture_logs() as log, ThreadPoolExecutor(1) as pool:

        def said(event):
            return [entry for entry in log if entry["event"] == event]

        outcome = pool.submit(run_worker, replace(MILL, attempt_command=command), store, settings, stop)
        wait_for(lambda: said("claim-put-off") and said("files-not-looked-after"))
        assert (list(folder.iterdir()), store.jobs.get(job.id).state) == ([], JobState.QUEUED)
        folder.rmdir()
        aside.rename(folder)
        wait_for(lambda: store.jobs.get(job.id).state is JobState.SUCCEEDED or outcome.done())
        stop.set()
        outcome.result(timeout=60)
        assert [len(said(event)) for event in ("claim-put-off", "files-not-looked-after")] == [1, 1]
    ended = store.jobs.get(job.id)
    assert (ended.state, ended.attempt, ended.losses) == (JobState.SUCCEEDED, 1, 0)


def test_a_job_whose_file_is_missing_waits_until_it_is_back(store, runner, queue):
    job = queue("succeed")
    file = store.files.upload(job.kind, job.subject_id)
    file.rename(file.with_name("aside"))
    assert runner.run_next() is JobState.QUEUED
    waiting = store.jobs.get(job.id)
    assert (waiting.waiting_for.code, waiting.losses) == ("storage-unavailable", 0)
    assert f"lacks the file 'uploads/scans/{job.subject_id}/original'" in waiting.waiting_for.detail
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


def test_housekeeping_says_once_that_a_disk_is_read_only(store, settings, stop, monkeypatch):
    monkeypatch.setattr("sawmill_platform.files.file_store.is_read_only", lambda _: True)
    housekeeping = MillHousekeeping(store, settings, stop)
    with capture_logs() as log:
        for _ in range(3):
            housekeeping.once()
    assert [entry["event"] for entry in log] == ["files-not-looked-after"]


@pytest.mark.parametrize("call", ["mkdir", "rename"])
def test_a_disk_that_becomes_read_only_costs_no_loss(store, runner, stop, queue, monkeypatch, call):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), "/mill")

    job = queue("succeed")
    with monkeypatch.context() as patched:
        patched.setattr(f"pathlib.Path.{call}", refuse)
        if call == "rename":  # what was computed waits while the disk can be read; a stopping worker gives it back
            patched.setattr(store.jobs, "succeed", stopping(store.jobs.succeed, stop))
        assert runner.run_next() is JobState.QUEUED
    waiting = store.jobs.get(job.id)
    assert (waiting.waiting_for.code, waiting.losses, waiting.attempt) == ("storage-unavailable", 0, 1)
    stop.clear()
    assert runner.run_next() is JobState.SUCCEEDED


def test_a_folder_that_goes_before_a_result_is_checked_costs_no_loss(store, runner, queue, monkeypatch):
    job, folder = queue("succeed"), store.files.folder
    aside = folder.with_name("mounted elsewhere")

    def check(*_):
        folder.rename(aside)
        folder.mkdir()
        raise InvalidOutput("the job left the files [], and scan.h5 is due")

    with monkeypatch.context() as patched:
        patched.setattr("sawmill_store.subjects.outputs.check_output", check)
        assert runner.run_next() is JobState.QUEUED
    waiting = store.jobs.get(job.id)
    assert (waiting.waiting_for.code, waiting.losses) == ("storage-unavailable", 0)
    folder.rmdir()
    aside.rename(folder)
    assert runner.run_next() is JobState.SUCCEEDED


@pytest.mark.parametrize("behaviour", ["miss-its-folder", "miss-its-file"])
def test_a_folder_that_was_away_for_a_moment_costs_no_loss(store, runner, queue, behaviour):
    job = queue(behaviour)
    assert runner.run_next() is JobState.QUEUED
    waiting = store.jobs.get(job.id)
    assert (waiting.waiting_for.code, waiting.losses) == ("storage-unavailable", 0)
    assert runner.run_next() is JobState.SUCCEEDED


def test_another_file_that_a_job_misses_is_a_defect(store, runner, queue):
    job = queue("miss-something-else")
    assert runner.run_next() is JobState.FAILED
    assert store.jobs.get(job.id).failure.code == "internal-error"


def test_a_folder_that_goes_under_the_supervisor_costs_no_loss(store, runner, queue, monkeypatch):
    job = queue("succeed")
    with monkeypatch.context() as patched:
        patched.setattr("sawmill_platform.attempts.runner._Supervision._begin", lambda *_: Path("/mill/is/away").stat())
        assert runner.run_next() is JobState.QUEUED
    assert store.jobs.get(job.id).losses == 0
    assert runner.run_next() is JobState.SUCCEEDED


def test_a_read_only_disk_is_said_once_while_a_result_waits_for_it(store, runner, stop, queue, monkeypatch):
    def refuse(*_, **__):
        nonlocal asked
        asked += 1
        if asked == 3:
            stop.set()
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), "/mill")

    job, asked = queue("succeed"), 0
    with capture_logs() as log, monkeypatch.context() as patched:
        patched.setattr("pathlib.Path.rename", refuse)
        assert runner.run_next() is JobState.QUEUED
    assert (asked >= 3, [entry["event"] for entry in log].count("end-put-off")) == (True, 1)
    assert store.jobs.get(job.id).losses == 0


def stopping(succeed, stop):
    def call(*arguments, **options):
        stop.set()
        return succeed(*arguments, **options)

    return call
