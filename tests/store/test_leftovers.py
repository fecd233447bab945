"""What kills and failed commits leave goes with time, and nothing else; files that somebody took away are named."""

import errno
import os
import shutil
import sqlite3
import tarfile
import threading
from contextlib import closing, contextmanager

import pytest
from emptied_databases import ARCHIVE, sqlite_alone
from machine_faults import at_call, refusing
from results import RESULTS, answer_of
from sqlalchemy import event, text
from sqlalchemy.exc import OperationalError

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scans import ScanState
from sawmill_platform.backups.taking import take_backup
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobKind, JobState
from sawmill_platform.errors import (
    FolderUnavailable,
    StorageFull,
    StorageMisconfigured,
    StorageUnavailable,
    disk_outage_reported,
)
from sawmill_platform.files.file_store import IDENTITY, FileStore, read_identity
from sawmill_platform.files.named_folders import NAMES_A_ROUND
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

GRACE_S = 3600.0
AWAY = sqlite3.OperationalError("server closed the connection unexpectedly")
FULL = sqlite3.OperationalError("database or disk is full")
FULL.sqlite_errorcode = sqlite3.SQLITE_FULL
INPUT = Failure(kind=FailureKind.INPUT, code="phantom-not-seen", detail="no phantom here")


class Observer:
    def __init__(self, store):
        self.now_s = 0.0
        self.leftovers = store.leftovers(grace_s=GRACE_S, now_s=lambda: self.now_s)

    def look(self, after_s=0.0):
        self.now_s += after_s
        return self.leftovers.remove_some()


@pytest.fixture
def observer(store):
    return Observer(store)


@pytest.fixture
def claimed(store, upload):
    upload(store)
    claim = store.jobs.claim("test")
    assert claim is not None
    return claim


def made(path):
    path.mkdir(parents=True)
    (path / "file").write_text("")
    return path


@contextmanager
def failing_commit(store, error):
    def fail(_):
        raise OperationalError("COMMIT", {}, error)

    event.listen(store.database.engine, "commit", fail)
    try:
        yield
    finally:
        event.remove(store.database.engine, "commit", fail)


def test_what_no_row_knows_goes_after_its_grace_and_nothing_else_does(store, observer, ready_scan, claimed):
    files, running = store.files, claimed
    refused = store.scans.get(claimed.job.subject_id)
    known = [
        files.results(kinds.INGEST, ready_scan.id),
        files.upload(kinds.INGEST, ready_scan.id),
        files.upload(kinds.INGEST, refused.id),
        files.make_attempt_folder(running.job_id, running.attempt),
        made(files.folder / "kept" / running.job_id),
        made(files.folder / "scans" / "Not a name of ours"),
    ]
    unknown = [
        files.make_attempt_folder(running.job_id, running.attempt + 1),
        files.make_attempt_folder(ready_scan.job_id, 1),
        made(files.folder / "attempts" / f"{ready_scan.job_id}-1"),  # as the first versions named it
        made(files.folder / "kept" / ready_scan.job_id),
        made(files.upload(kinds.INGEST, "nobodys").parent),
        made(files.upload(kinds.TRACE_PHANTOM, "nobodys").parent),
        made(files.results(kinds.INGEST, refused.id)),
        *(made(files.results(kind, "nobodys")) for kind in JobKind.all()),
        files.receive([b"x"], max_bytes=1).path,
        made(files.folder / "removed" / ("0" * 32)),
    ]
    assert observer.look() == observer.look(GRACE_S - 1.0) == []
    assert Observer(store).look() == [], "one that starts anew begins to count anew"
    assert sorted(observer.look(0.25 * GRACE_S)) == sorted(unknown)
    assert not any(path.exists() for path in unknown)
    assert all(path.exists() for path in known)
    assert list((files.folder / "removed").iterdir()) == []


def test_an_upload_that_still_arrives_is_left_alone(store, observer):
    arriving = store.files.folder / "incoming" / ("a" * 32)
    for size in range(1, 9):
        arriving.write_bytes(bytes(size))
        assert observer.look(0.9 * GRACE_S) == []
    assert observer.look(1.1 * GRACE_S) == [arriving]


def test_an_upload_that_was_given_up_is_refused_when_it_comes_after_all(store, upload):
    received = store.files.receive([b"scan"], max_bytes=10)
    received.path.unlink()
    with pytest.raises(StorageUnavailable, match="stood still until it was given up: send it again"):
        upload(store, received=received)
    assert store.scans.page().items == []


@pytest.mark.dialect
def test_what_is_named_and_not_yet_committed_stays(store, observer, upload):
    named, goes_on = threading.Event(), threading.Event()

    def linger(_):
        named.set()
        goes_on.wait(60.0)

    accepting = threading.Thread(target=upload, args=(store,), kwargs={"scan_id": "mine"})
    event.listen(store.database.engine, "commit", linger, once=True)
    accepting.start()
    named.wait(60.0)
    folder = store.files.upload(kinds.INGEST, "mine").parent
    assert folder.exists()
    threading.Timer(0.3, goes_on.set).start()
    observer.look()
    # The reading at the second look may come before the commit; its removing then waits for it.
    assert observer.look(2 * GRACE_S) == observer.look(2 * GRACE_S) == []
    accepting.join()
    assert folder.exists()
    assert store.scans.get("mine").state is ScanState.INGESTING


def test_an_upload_whose_commit_finds_the_disk_full_leaves_nothing(store, upload):
    with failing_commit(store, FULL), pytest.raises(StorageFull):
        upload(store, scan_id="mine")
    assert list(store.files.folder.glob("uploads/scans/*")) == list(store.files.folder.glob("incoming/*")) == []


def test_an_upload_whose_commit_may_have_come_through_waits_for_its_row(store, observer, upload):
    with failing_commit(store, AWAY), pytest.raises(StorageUnavailable):
        upload(store, scan_id="mine")
    folder = store.files.upload(kinds.INGEST, "mine").parent
    assert store.scans.page().items == []
    assert folder.exists(), "had the answer to the commit been lost alone, the scan would need it"
    observer.look()
    assert observer.look(GRACE_S) == [folder]
    assert upload(store, scan_id="mine").state is ScanState.INGESTING


@pytest.mark.parametrize("error", [FULL, AWAY])
def test_a_result_whose_commit_fails_is_not_there_and_its_job_runs_again(store, observer, claimed, finish, error):
    scan_id = claimed.job.subject_id
    output = store.files.make_attempt_folder(claimed.job_id, claimed.attempt)
    (output / "result").write_text("attempt 1")
    with failing_commit(store, error), pytest.raises((StorageFull, StorageUnavailable)):
        store.jobs.succeed(claimed, answer_of(kinds.INGEST, RESULTS[kinds.INGEST]()), output)
    assert store.jobs.get(claimed.job_id).state is JobState.RUNNING
    assert store.scans.get(scan_id).state is ScanState.INGESTING
    store.jobs.release(claimed)
    finish(store)
    assert (store.files.results(kinds.INGEST, scan_id) / "result").read_text() == "attempt 2"
    observer.look()
    assert observer.look(GRACE_S) == []


def test_a_result_whose_commit_failed_goes_when_its_job_never_succeeds(store, observer, claimed):
    output = store.files.make_attempt_folder(claimed.job_id, claimed.attempt)
    with failing_commit(store, AWAY), pytest.raises(StorageUnavailable):
        store.jobs.succeed(claimed, answer_of(kinds.INGEST, RESULTS[kinds.INGEST]()), output)
    store.jobs.fail(claimed, INPUT)
    observer.look()
    assert observer.look(GRACE_S) == [store.files.results(kinds.INGEST, claimed.job.subject_id)]


@pytest.mark.dialect
def test_a_scan_that_was_deleted_by_half_goes_wholly(store, observer, ready_scan):
    with at_call("os.rename", lambda _: 1 / 0, below=store.files.folder), pytest.raises(ZeroDivisionError):
        store.scans.delete(ready_scan.id)
    observer.look()
    gone = [store.files.results(kinds.INGEST, ready_scan.id), store.files.upload(kinds.INGEST, ready_scan.id).parent]
    assert sorted(observer.look(GRACE_S)) == sorted(gone)


@sqlite_alone
def test_a_round_is_cheap_however_many_folders_there_are(store, observer):
    for index in range(2 * NAMES_A_ROUND + 1):
        (store.files.folder / "plans" / f"nobodys-{index}").mkdir()
    statements = []
    event.listen(store.database.engine, "before_cursor_execute", lambda *given: statements.append(given[2]))
    counts = []
    for _ in range(3):
        observer.look()
        counts.append(len(statements))
        statements.clear()
    # A round has one question for each batch, and the next ones none until it is time again.
    assert max(counts) <= 2
    assert observer.look() == []
    assert statements == []
    observer.now_s += GRACE_S
    assert [len(observer.look()) for _ in range(3)] == [NAMES_A_ROUND, NAMES_A_ROUND, 1]


def test_one_that_cannot_be_removed_does_not_keep_the_others(store, observer):
    stuck, other = (made(store.files.results(kinds.PLAN, name)) for name in ("a-stuck", "b-other"))
    observer.look()
    with at_call("os.rename", refusing(errno.EACCES), below=stuck), pytest.raises(PermissionError, match="a-stuck"):
        observer.look(GRACE_S)
    assert stuck.exists()
    assert not other.exists()


def test_uploads_and_results_without_their_file_are_lost(store, upload, finish):
    scan = upload(store)
    finish(store)
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
    finish(store)
    reconstruction = store.reconstructions.accept(ReconstructionRequest(scan_id=scan.id, calibration_id=calibration.id))
    finish(store)
    unread = upload(store)
    files = [
        store.files.results(kinds.CALIBRATE, calibration.id) / "result.h5",
        store.files.results(kinds.RECONSTRUCT, reconstruction.id) / "volume.h5",
        store.files.results(kinds.INGEST, scan.id) / "scan.h5",
        *sorted(store.files.upload(kinds.INGEST, one.id) for one in (scan, unread)),
    ]
    for file in files[:3]:
        file.touch()
    assert store.lost_files() == []
    for file in files:
        file.unlink()
    assert store.lost_files() == [file.relative_to(store.files.folder).as_posix() for file in files]


def test_what_is_deleted_meanwhile_is_not_lost(store, ready_scan):
    """The transaction that has read the rows shows them as they were."""
    deleted = []

    def delete_once(*given):
        if "FROM scans" in given[2] and not deleted:
            deleted.append(given[2])
            store.scans.delete(ready_scan.id)

    event.listen(store.database.engine, "after_cursor_execute", delete_once)
    assert store.lost_files() == []
    assert len(deleted) == 1


@pytest.fixture
def apart(filled, tmp_path):
    """Settings of a store whose database is not in its folder, as on a server: the folder alone can go."""
    if filled.database_url is not None:
        return filled
    shutil.move(filled.data_folder / "sawmill.db", tmp_path / "apart.db")
    return filled.model_copy(update={"database_url": f"sqlite:///{tmp_path}/apart.db"})


@pytest.fixture
def store(apart):
    with closing(Store(apart)) as opened:
        yield opened


def identity_of(store):
    with store.database.read() as session:
        return session.execute(text("SELECT identity FROM data_folder")).scalar_one()


@contextmanager
def replaced(folder, by):
    """Have something else in the folder's place: nothing, an empty folder, or one of another service."""
    aside = folder.with_name("mounted elsewhere")
    folder.rename(aside)
    if by != "missing":
        folder.mkdir()
    if by == "another":
        (folder / IDENTITY).write_text("of another service\n")
        (folder / "scans" / "theirs").mkdir(parents=True)
    yield
    if folder.exists():
        shutil.rmtree(folder)
    aside.rename(folder)


def test_a_first_start_gives_both_one_identity_which_a_copy_keeps(tmp_path):
    settings = StorageSettings(data_folder=tmp_path / "first", database_url=None)
    with closing(Store.open(settings)) as store:
        first = identity_of(store)
    shutil.copytree(tmp_path / "first", tmp_path / "copy")
    with closing(Store.open(settings.model_copy(update={"data_folder": tmp_path / "copy"}))) as store:
        assert identity_of(store) == read_identity(tmp_path / "copy") == read_identity(tmp_path / "first") == first
        assert len(first) == 32


@sqlite_alone
@pytest.mark.parametrize("by", ["missing", "empty", "another"])
def test_a_folder_that_is_not_the_database_s_is_an_outage_and_nothing_is_made_in_it_or_of_it(apart, tmp_path, by):
    (tmp_path / "backups").mkdir()
    with replaced(apart.data_folder, by):
        before = sorted(apart.data_folder.rglob("*"))
        for may_begin in (True, False):
            with pytest.raises(FolderUnavailable, match=f"{apart.data_folder}.*the database expects"):
                Store.open(apart, may_begin=may_begin)
        with pytest.raises(FolderUnavailable, match="the database expects"):
            take_backup(apart, tmp_path / "backups", lambda _: None, named=())
        assert sorted(apart.data_folder.rglob("*")) == before
    assert list((tmp_path / "backups").glob("sawmill-*")) == []
    Store.open(apart, may_begin=False).close()


@pytest.mark.dialect
def test_no_job_is_claimed_while_the_folder_is_not_in_its_place(store, upload, request):
    upload(store)
    for by in ("missing", "empty", "another"):
        with replaced(store.files.folder, by):
            with pytest.raises(FolderUnavailable, match="the database expects"):
                store.jobs.claim("a worker")
            with pytest.raises(FolderUnavailable, match="the database expects"):
                store.check()
    request.getfixturevalue("read_only_disk")
    with pytest.raises(FolderUnavailable, match="read-only"):
        store.jobs.claim("a worker")
    with pytest.raises(FolderUnavailable, match="read-only"):
        Store.open(store.settings, may_begin=False)
    assert [job.attempt for job in store.jobs.page().items] == [0]


def test_a_worker_begins_neither_a_database_nor_a_folder(tmp_path):
    settings = StorageSettings(data_folder=tmp_path / "data", database_url=None)
    with pytest.raises(FolderUnavailable, match="start sawmill serve first"):
        Store.open(settings, may_begin=False)
    assert not settings.data_folder.exists()


@sqlite_alone
def test_a_new_database_is_refused_for_a_folder_with_files_of_another_one(apart, tmp_path):
    (apart.data_folder / "scans" / "old").mkdir()
    with pytest.raises(StorageMisconfigured, match="has files, and the database is new"):
        Store.open(apart.model_copy(update={"database_url": f"sqlite:///{tmp_path}/new.db"}))


@pytest.mark.slow
def test_a_folder_of_0_1_0_gets_its_identity_with_its_database_and_no_empty_one_does(tmp_path):
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path / "data", filter="data")
    shutil.move(tmp_path / "data" / "sawmill.db", tmp_path / "apart.db")
    url = f"sqlite:///{tmp_path}/apart.db"
    (tmp_path / "empty").mkdir()
    for may_begin in (True, False):
        with pytest.raises(FolderUnavailable, match="none of the files that the database names"):
            Store.open(StorageSettings(data_folder=tmp_path / "empty", database_url=url), may_begin=may_begin)
    with closing(sqlite3.connect(tmp_path / "apart.db")) as connection:
        assert connection.execute("SELECT version_num FROM alembic_version").fetchone() == ("0003",)
    settings = StorageSettings(data_folder=tmp_path / "data", database_url=url)
    with closing(Store.open(settings, may_begin=False)) as store:
        assert identity_of(store) == read_identity(tmp_path / "data")
    assert list((tmp_path / "empty").iterdir()) == []


@pytest.mark.parametrize("number", [errno.EROFS, errno.EIO, errno.ESTALE, errno.ENOENT])
def test_a_disk_that_fails_is_read_only_or_away_is_an_outage(number):
    given_up = pytest.raises(FolderUnavailable, match="the upload was given up")
    with given_up as refused, disk_outage_reported("the upload"):
        raise OSError(number, os.strerror(number), "/mill/incoming")
    assert refused.value.code == "storage-unavailable"


def test_what_a_read_only_disk_keeps_is_left_for_housekeeping(tmp_path):
    files = FileStore(tmp_path)
    files.make_folders()
    output = files.make_attempt_folder("job", 1)
    with at_call("os.rename", refusing(errno.EROFS), below=tmp_path):
        files.remove(output)
        with pytest.raises(FolderUnavailable):
            files.publish(output, tmp_path / "scans" / "one")
    assert output.is_dir()
