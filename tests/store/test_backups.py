"""A backup that is taken while everything goes on, and what becomes of it elsewhere, on each database."""

import ctypes
import errno
import hashlib
import os
import shutil
import signal
import subprocess
import tarfile
from contextlib import closing
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from emptied_databases import ARCHIVE, sqlite_alone
from machine_faults import at_call, refusing
from results import CONSTANTS, succeed
from sqlalchemy import text

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.backups import taking
from sawmill_platform.backups.backup import MANIFEST, SUMS, Backup, copied, read_sums
from sawmill_platform.backups.database_copy import copy_rows
from sawmill_platform.backups.restoring import NOT_RESTORED, restore
from sawmill_platform.backups.taking import backups_in, remove_older
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.contracts.uploads import UploadRequest
from sawmill_platform.database.database import Database, newest_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import Base
from sawmill_platform.errors import BackupRefused, Damaged, StorageMisconfigured
from sawmill_platform.files import whole_files
from sawmill_platform.files.file_store import RESTORING, read_identity
from sawmill_platform.files.upload_stream import AsSent
from sawmill_platform.keys.key_store import hash_of
from sawmill_platform.ledger.events import NUMBERS_SKIPPED
from sawmill_platform.settings import StorageSettings
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_store.mill_files import NAMED_FOLDERS
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind
from sawmill_vocabulary.version import VERSION

pytestmark = pytest.mark.slow

take_backup = partial(taking.take_backup, named=NAMED_FOLDERS)


def silent(_progress):
    """Nobody looks at the progress."""


@pytest.fixture
def into(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    return folder


@pytest.fixture
def elsewhere(request, tmp_path):
    kind = request.node.callspec.params.get("database_url") if hasattr(request.node, "callspec") else None
    url = request.getfixturevalue("postgres_url") if kind == "postgresql" else None
    return StorageSettings(data_folder=tmp_path / "elsewhere", database_url=url)


def work(store, upload, finish):
    scan = upload(store)
    finish(store)
    return scan.id


def rows_of(settings):
    with closing(Database(make_engine(settings.url))) as database, database.read() as session:
        return {
            name: [dict(row) for row in session.execute(table.select().order_by(*table.primary_key)).mappings()]
            for name, table in Base.metadata.tables.items()
        }


def files_of(settings):
    return {
        path.relative_to(settings.data_folder).as_posix(): (path.stat().st_mtime_ns, copied(path))
        for name in ("uploads", "scans", "calibrations", "unfinished", "examples")
        for path in (settings.data_folder / name).rglob("*")
        if path.is_file()
    }


@pytest.mark.dialect
def test_what_is_restored_elsewhere_is_all_there_and_goes_on(
    store, settings, upload, finish, ready_scan, scanner, into, elsewhere
):
    now = store.now()
    running = upload(store)
    claim = store.jobs.claim("a worker that is not there")
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id))
    waiting = upload(store)
    key = store.keys.create(KeyRequest(name='line 2, "north" \\N', scope=Scope.SUBMIT))
    session = store.sessions.open(hash_of(key.secret), lasting=False)
    schedule = store.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="* * * * *"))
    with store.database.write() as changing:
        changing.execute(text("UPDATE schedules SET next_due_at = :at"), {"at": f"{now - timedelta(days=3):%F %T.%f}"})
    half = store.uploads.create(UploadRequest(size_bytes=10), UploadQuota(3, 25, 40))
    part = store.uploads.begin_part(half.id, 0)
    part.take(AsSent(), b"0123", commits=True)
    part.finish(AsSent())
    part.close()
    later = store.uploads.begin_part(half.id, 4)
    later.take(AsSent(), b"45", commits=True)  # on its way, and not counted
    (store.files.folder / "examples").mkdir()
    (store.files.folder / "examples" / "complete").touch()

    taken = take_backup(settings, into, silent)
    later.close()
    assert Backup(taken.path).damage(silent) == []
    assert restore(taken.path, elsewhere, silent) == taken.manifest

    before, after = rows_of(settings), rows_of(elsewhere)
    for name in before.keys() - {row.__tablename__ for row in NOT_RESTORED} - {"jobs", "events"}:
        assert after[name] == before[name], name
    assert after["sessions"] == []
    (restored_folder,), (folder,) = after["data_folder"], before["data_folder"]
    assert restored_folder["identity"] == read_identity(elsewhere.data_folder) != folder["identity"]
    numbers = [event["number"] for event in before["events"]]
    assert after["events"][: len(numbers)] == before["events"]
    mark, given_back = after["events"][len(numbers) :]
    assert (mark["type"], mark["number"]) == (event_kinds.RESTORED, numbers[-1] + NUMBERS_SKIPPED)
    assert (given_back["type"], given_back["job_id"]) == (event_kinds.GIVEN_BACK, running.job_id)
    theirs, ours = files_of(elsewhere), files_of(settings)
    ours.pop(f"unfinished/{half.id}")
    assert theirs.pop(f"unfinished/{half.id}")[1] == hashlib.sha256(b"0123").hexdigest()
    assert theirs == ours

    with closing(Store.open(elsewhere)) as restored:
        assert restored.keys.good(hash_of(key.secret)) is not None
        assert (restored.sessions.find(session), len(restored.schedules.run_due())) == (None, 1)
        assert restored.schedules.get(schedule.id).last_run is not None
        assert restored.uploads.begin_part(half.id, 4).upload.offset_bytes == 4
        again = restored.jobs.get(running.job_id)
        assert (again.state, again.losses, again.attempt, again.worker) == (JobState.QUEUED, 0, claim.attempt, None)
        subjects = [finish(restored).job.subject_id for _ in range(3)]
        assert subjects[:3] == [running.id, calibration.id, waiting.id]
        assert restored.events.following(given_back["number"])[0].number == given_back["number"] + 1


@sqlite_alone
def test_an_unchanged_file_is_linked_and_not_read(store, settings, upload, finish, into):
    twin = store.files.results(kinds.INGEST, work(store, upload, finish)) / "twin"
    twin.hardlink_to(twin.with_name("result"))
    first = take_backup(settings, into, silent)
    sizes = [(first.path / path).stat().st_size for path in read_sums(first.path) if path.startswith("data/")]
    assert first.copied_bytes == sum(sizes) - twin.stat().st_size
    opened = []
    with at_call("open", opened.append, below=settings.data_folder / "scans"):
        assert take_backup(settings, into, silent).copied_bytes == 0
    assert opened == []
    second_scan = work(store, upload, finish)
    second = take_backup(settings, into, silent)
    new = {path: (second.path / path).stat().st_size for path in read_sums(second.path) if second_scan in path}
    assert len(new) == 2
    assert second.copied_bytes == sum(new.values())
    old = [path for path in read_sums(first.path) if path.startswith("data/")]
    both = [(taken.path / path).stat().st_ino for path in old for taken in (first, second)]
    assert len(set(both)) == 2, "an upload and a result, whatever their names"
    done = subprocess.run(["sha256sum", "--check", "--quiet", SUMS], cwd=second.path, check=False)
    assert done.returncode == 0, "the list can be checked without this product"
    of_a_wrong_clock = first.path.rename(into / "sawmill-20380119T031407Z")
    assert len(remove_older(into, 2, second.path)) == 1
    assert remove_older(into, 1, second.path) == [of_a_wrong_clock], "not the one that was just taken"
    assert backups_in(into) == [second.path]
    assert Backup(second.path).damage(silent) == []


@sqlite_alone
def test_a_backup_is_durable_before_it_has_its_name(settings, store, upload, finish, into, monkeypatch):
    lists = []

    def lose(_descriptor):
        lists.extend(into.glob(f".*.partial/{SUMS}"))
        ctypes.set_errno(errno.EIO)
        return -1

    work(store, upload, finish)
    monkeypatch.setattr(whole_files, "_LIBC", SimpleNamespace(syncfs=lose))
    with pytest.raises(OSError, match="Input/output error"):
        take_backup(settings, into, silent)
    assert len(lists) == 1, "all is written when the disk is asked to keep it"
    assert list(into.glob("*sawmill-2*")) == []


@pytest.mark.dialect
def test_what_is_deleted_meanwhile_is_in_neither_rows_nor_files(store, settings, upload, finish, into, elsewhere):
    scans = sorted(work(store, upload, finish) for _ in range(3))
    steps = []

    def on_progress(_progress):
        steps.append(1)
        if len(steps) == 1:
            store.scans.delete(scans[2])
            steps.append(work(store, upload, finish))

    taken = take_backup(settings, into, on_progress)
    assert taken.manifest.lacking == []
    there = {path.split("/")[2] for path in read_sums(taken.path) if path.startswith("data/scans/")}
    assert there == {*scans[:2], steps[1]}
    restore(taken.path, elsewhere, silent)
    assert {row["id"] for row in rows_of(elsewhere)["scans"]} == there


@sqlite_alone
def test_a_file_that_is_really_missing_is_named_and_keeps_nothing_else_out(
    store, settings, upload, finish, into, elsewhere
):
    lost, kept = work(store, upload, finish), work(store, upload, finish)
    shutil.rmtree(store.files.results(kinds.INGEST, lost))
    taken = take_backup(settings, into, silent)
    assert taken.manifest.lacking == [f"scans/{lost}"]
    restore(taken.path, elsewhere, silent)
    assert (elsewhere.data_folder / "scans" / kept / "result").is_file()


@pytest.fixture(scope="module")
def one_backup(tmp_path_factory, empty_data):
    """Of a service on SQLite with two scans, and the service's own folder beside it."""
    folder = tmp_path_factory.mktemp("one")
    settings = StorageSettings(data_folder=folder / "data", database_url=None)
    shutil.copytree(empty_data, settings.data_folder)
    with closing(Store(settings)) as store:
        scanner = store.scanners.create(ScannerSpec(name="Line 2", constants=ScannerConstants(**CONSTANTS)))
        for number in range(2):
            spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
            store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10))
            content = f"line integrals {number}"
            succeed(store, write=lambda output, content=content: (output / "scan.h5").write_text(content))
    (folder / "disk").mkdir()
    return take_backup(settings, folder / "disk", silent).path


@pytest.fixture
def backup(one_backup, tmp_path):
    return Path(shutil.copytree(one_backup, tmp_path / one_backup.name))


def nothing_in(settings):
    return {path.name for path in settings.data_folder.rglob("*")} <= {"serve.lock"}


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def replaced_by_link(path):
    path.rename(path.parents[3] / "aside")
    path.symlink_to(path.parents[3] / "aside")


def replaced_by_pipe(path):
    path.unlink()
    os.mkfifo(path)


def replaced_by_another(path):
    path.unlink()
    path.hardlink_to(next(other for other in path.parents[1].rglob("scan.h5") if other != path))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (flip, "is damaged: its SHA-256 is"),
        (Path.unlink, "is missing"),
        (replaced_by_link, "is no file, but a link or a device"),
        (replaced_by_pipe, "is no file, but a link or a device"),
        (replaced_by_another, "is damaged: its SHA-256 is"),
        (lambda path: path.with_name("more").touch(), "more is not in SHA256SUMS"),
    ],
    ids=["flipped", "missing", "link", "pipe", "another", "added"],
)
def test_damage_is_found_and_named_and_never_restored(backup, elsewhere, damage, words):
    path = sorted((backup / "data").rglob("scan.h5"))[1]
    damage(path)
    assert any(words in each and str(path.parent.name) in each for each in Backup(backup).damage(silent))
    with pytest.raises(Damaged):
        restore(backup, elsewhere, silent)
    assert nothing_in(elsewhere)


@pytest.mark.parametrize("name", [MANIFEST, SUMS, "database/sawmill.db"])
def test_a_flipped_bit_in_rows_manifest_or_sums_is_found_too(backup, elsewhere, name):
    flip(backup / name)
    with pytest.raises(Damaged):
        restore(backup, elsewhere, silent)
    assert nothing_in(elsewhere)


@pytest.mark.parametrize(
    "path", ["../evil", "/etc/evil", "data/scans/../../evil", "data/evil", "data/a//b", "database/..", "data/a/b\\c"]
)
def test_a_list_of_sums_that_leaves_the_backup_is_refused(backup, elsewhere, path):
    (backup / SUMS).write_text(f"{hashlib.sha256(b'').hexdigest()}  {path}\n")
    with pytest.raises(Damaged, match=r"line 1 of SHA256SUMS names no file of a backup"):
        restore(backup, elsewhere, silent)
    assert not elsewhere.data_folder.exists()


def test_a_backup_of_another_version_is_refused(backup, elsewhere):
    sums = read_sums(backup)
    content = (backup / MANIFEST).read_text().replace(newest_revision(), "9999").replace(VERSION, "7.0.0")
    (backup / MANIFEST).write_text(content)
    (backup / SUMS).write_text((backup / SUMS).read_text().replace(sums[MANIFEST], copied(backup / MANIFEST)))
    with pytest.raises(BackupRefused, match=f"version 7.0.0 .* 9999, and this .*{VERSION}, .*: install version 7.0.0"):
        restore(backup, elsewhere, silent)
    (backup / SUMS).rename(backup / "manifest.json")
    with pytest.raises(Damaged, match=r"of a development version before 0.2.0: restore it with that version"):
        restore(backup, elsewhere, silent)


@pytest.mark.dialect
def test_a_backup_of_an_earlier_version_is_brought_up_to_date(empty_url, into, elsewhere, tmp_path):
    columns = "id, created_at, kind, state, subject_id, attempt, cancel_requested"
    values = "'old', '2026-03-02 05:00:00', 'ingest', 'running', 'old', 2, false"
    with closing(Database(make_engine(empty_url))) as database:
        database.upgrade("0003")
        with database.write() as session:
            session.execute(text(f"INSERT INTO jobs ({columns}) VALUES ({values})"))  # noqa: S608 - constants
    (tmp_path / "old").mkdir()
    taken = take_backup(StorageSettings(data_folder=tmp_path / "old", database_url=empty_url), into, silent)
    assert taken.manifest.revision == "0003"
    if elsewhere.database_url is not None:
        with closing(Database(make_engine(empty_url))) as database, database.write() as session:
            session.execute(text("DROP SCHEMA public CASCADE"))
            session.execute(text("CREATE SCHEMA public"))
    restore(taken.path, elsewhere, silent)
    with closing(Store.open(elsewhere)) as restored:
        claim = restored.jobs.claim("test")
    assert (claim.job_id, claim.attempt, claim.job.losses) == ("old", 3, 0)
    assert claim.job.created_at == datetime(2026, 3, 2, 5, tzinfo=UTC)


def test_what_must_not_be_done_is_refused_in_a_sentence(filled, settings, backup, into, elsewhere, tmp_path):
    assert filled == settings
    with pytest.raises(BackupRefused, match="lies in the data folder"):
        take_backup(settings, settings.data_folder / "scans", silent)
    with pytest.raises(BackupRefused, match=r"there is no folder .*: make it once"):
        take_backup(settings, into / "none", silent)
    with pytest.raises(BackupRefused, match="there is no service's data in"):
        take_backup(StorageSettings(data_folder=tmp_path / "none", database_url=None), into, silent)
    with pytest.raises(Damaged, match=r"is no backup of this product: it has no SHA256SUMS"):
        restore(into, elsewhere, silent)
    own = take_backup(settings, into, silent).path
    with pytest.raises(BackupRefused, match=r"is not empty .*: a backup is restored into an empty folder alone"):
        restore(own, settings, silent)
    if settings.database_url is not None:
        full = elsewhere.model_copy(update={"database_url": settings.database_url})
        with pytest.raises(BackupRefused, match="the database of SAWMILL_DATABASE_URL is not empty"):
            restore(own, full, silent)
        with pytest.raises(BackupRefused, match="of the kind sqlite, and SAWMILL_DATABASE_URL names another"):
            restore(backup, elsewhere, silent)


def full_at(name):
    refuse = refusing(errno.ENOSPC)
    return lambda path: refuse(path) if path.endswith(name) else None


@sqlite_alone
@pytest.mark.parametrize(("call", "name"), [("open", "result"), ("sqlite3.connect", "sawmill.db"), ("open", SUMS)])
def test_a_full_disk_leaves_no_backup(settings, store, upload, finish, into, call, name):
    work(store, upload, finish)
    with at_call(call, full_at(name), below=into), pytest.raises(OSError, match="No space"):
        take_backup(settings, into, silent)
    assert [path.name for path in into.iterdir()] == [".sawmill-backups.lock"]


@pytest.mark.parametrize("name", ["scan.h5", "sawmill.db.restoring", ".identity.part"])
def test_a_full_disk_leaves_no_restored_service(backup, elsewhere, name):
    with at_call("open", full_at(name), below=elsewhere.data_folder), pytest.raises(OSError, match="No space"):
        restore(backup, elsewhere, silent)
    assert nothing_in(elsewhere)


def killed(call):
    child = os.fork()
    if child == 0:
        try:
            call()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def at_turn(turn):
    turns = [0]

    def die(_given):
        turns[0] += 1
        if turns[0] == turn:
            os.kill(os.getpid(), signal.SIGKILL)

    return die


@sqlite_alone
@pytest.mark.parametrize("call", ["open", "os.mkdir", "os.rename", "os.link", "os.remove", "sqlite3.connect"])
def test_a_backup_killed_at_any_call_leaves_nothing_that_looks_like_one(settings, store, upload, finish, into, call):
    work(store, upload, finish)
    there = take_backup(settings, into, silent).path
    shutil.rmtree(there / "data" / "uploads")
    turn = 1
    while backups_in(into) == [there]:
        with at_call(call, at_turn(turn), below=into):
            killed(lambda: take_backup(settings, into, silent))
        for whole in set(backups_in(into)) - {there}:
            assert Backup(whole).damage(silent) == []
        turn += 1
    take_backup(settings, into, silent)
    assert list(into.glob(".*.partial")) == []


@pytest.mark.parametrize("database_url", ["sqlite", "postgresql"], indirect=True)
@pytest.mark.parametrize("call", ["open", "os.rename", "os.remove"])
def test_a_restore_killed_at_any_call_leaves_nothing_that_starts_before_it_is_whole(
    settings, store, upload, finish, into, elsewhere, call
):
    work(store, upload, finish)
    taken = take_backup(settings, into, silent).path
    turn, mark = 1, elsewhere.data_folder / RESTORING
    while mark.exists() or read_identity(elsewhere.data_folder) is None:
        with at_call(call, at_turn(turn), below=elsewhere.data_folder):
            killed(lambda: restore(taken, elsewhere, silent))
        if mark.exists():
            with pytest.raises(StorageMisconfigured, match="was ended before its end: wait for it, or give it once"):
                Store.open(elsewhere)
        turn += 1
    assert turn > 2
    assert files_of(elsewhere) == files_of(settings)
    assert rows_of(elsewhere)["scans"] == rows_of(settings)["scans"]
    Store.open(elsewhere).close()


@pytest.mark.parametrize("version", ["0.1.0", "now"])
def test_rows_on_sqlite_are_copied_into_an_empty_postgresql(one_backup, tmp_path, postgres_url, version):
    if version == "now":
        shutil.copytree(one_backup.parents[1] / "data", tmp_path / "data")
    else:
        with tarfile.open(ARCHIVE) as archive:
            archive.extractall(tmp_path / "data", filter="data")
    source = StorageSettings(data_folder=tmp_path / "data", database_url=None)
    target = source.model_copy(update={"database_url": postgres_url})
    assert copy_rows(source, target) > 10
    with pytest.raises(BackupRefused, match="the database of SAWMILL_DATABASE_URL is not empty"):
        copy_rows(source, target)
    rows = rows_of(target)
    with closing(Database(make_engine(source.url))) as database:
        database.upgrade()
    there = rows_of(source)
    for table in rows.keys() - {"clock", "data_folder"}:
        assert rows[table] == there[table], table
    newest = max((event["number"] for event in rows["events"]), default=0)
    with closing(Store.open(target)) as store:
        store.keys.create(KeyRequest(name="line 2", scope=Scope.SUBMIT))
        assert store.events.following(newest)[0].number == newest + 1
