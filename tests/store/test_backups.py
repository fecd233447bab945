"""A backup that is taken while everything goes on, and what comes of it elsewhere, on each database and across."""

import ctypes
import errno
import hashlib
import json
import os
import shutil
import signal
import tarfile
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from databases import sqlite_alone
from make_data_0_1_0 import ARCHIVE
from results import CONSTANTS, RESULTS, answer_of
from sqlalchemy import JSON, Boolean, Date, Float, Integer, String, text
from system_calls import at_call

from sawmill_contracts import job_kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.backups.checking import check_backup
from sawmill_platform.backups.folders import backups_in, remove_older
from sawmill_platform.backups.manifest import FILES, MANIFEST, MANIFEST_SUM, read_entries, read_manifest
from sawmill_platform.backups.restoring import check_empty
from sawmill_platform.backups.rows import LEFT_OUT, read_rows
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_platform.contracts.uploads import UploadAsk
from sawmill_platform.database.database import Database, newest_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import Base, Ranked, Registered, UtcDateTime
from sawmill_platform.errors import BackupRefused, Damaged, StorageFull, StorageMisconfigured
from sawmill_platform.files import whole_files
from sawmill_platform.files.file_store import RESTORING, read_identity
from sawmill_platform.files.upload_stream import AsSent
from sawmill_platform.keys.key_store import hash_of
from sawmill_platform.ledger.events import NUMBERS_SKIPPED
from sawmill_platform.settings import StorageSettings
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_store.backups import restore, take_backup
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind
from sawmill_vocabulary.version import VERSION

pytestmark = pytest.mark.slow

Call = Callable[[], object]


def silent(_progress: object) -> None:
    """Nobody looks at the progress."""


@pytest.fixture
def into(tmp_path: Path) -> Path:
    folder = tmp_path / "disk"
    folder.mkdir()
    return folder


@pytest.fixture
def elsewhere(tmp_path: Path) -> StorageSettings:
    """An empty service on SQLite."""
    return StorageSettings(data_folder=tmp_path / "elsewhere", database_url=None)


@pytest.fixture
def target(request: pytest.FixtureRequest, elsewhere: StorageSettings) -> StorageSettings:
    """An empty service on each database; on the other one than a test's own, if it has one."""
    own = request.node.callspec.params.get("database_url")
    if getattr(request, "param", "postgresql" if own == "sqlite" else "sqlite") == "sqlite":
        return elsewhere
    return elsewhere.model_copy(update={"database_url": request.getfixturevalue("postgres_url")})


to_each = pytest.mark.parametrize("target", ["sqlite", "postgresql"], indirect=True)


@pytest.fixture
def work(store: Store, upload: Callable[..., Any], finish: Callable[..., Any]) -> Callable[..., str]:
    """Upload a scan and read it as a worker would: its id."""

    def do() -> str:
        scan = upload(store)
        finish(store)
        return scan.id

    return do


def rows_of(settings: StorageSettings) -> dict[str, list[Any]]:
    database = Database(make_engine(settings.url))
    with closing(SimpleNamespace(close=database.engine.dispose)), database.read() as session:
        return {
            name: [dict(row) for row in session.execute(table.select().order_by(*table.primary_key)).mappings()]
            for name, table in Base.metadata.tables.items()
        }


def files_of(settings: StorageSettings) -> dict[str, tuple[int, str]]:
    """What results and uploads are, with their times."""
    return {
        path.relative_to(settings.data_folder).as_posix(): (
            path.stat().st_mtime_ns,
            hashlib.sha256(path.read_bytes()).hexdigest(),
        )
        for name in ("uploads", "scans", "calibrations", "unfinished", "examples")
        for path in (settings.data_folder / name).rglob("*")
        if path.is_file()
    }


@pytest.mark.dialect
def test_what_is_restored_elsewhere_is_all_there_and_goes_on(
    store, settings, upload, finish, ready_scan, scanner, into, target
):
    now = store.now()
    running = upload(store)
    claim = store.jobs.claim("a worker that is not there")
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id))
    waiting = upload(store)
    key = store.keys.create(KeyAsk(name="line 2", scope=Scope.SUBMIT))
    session = store.sessions.open(hash_of(key.secret), lasting=False)
    schedule = store.schedules.create(ScheduleSpec(scanner_id=scanner.id, cron="* * * * *"))
    with store.database.write() as changing:
        changing.execute(text("UPDATE schedules SET next_due_at = :at"), {"at": f"{now - timedelta(days=3):%F %T}"})
    half = store.uploads.create(UploadAsk(size_bytes=10), UploadQuota(3, 25, 40))
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
    assert check_backup(taken.path, silent) == (taken.manifest, [])
    assert restore(taken.path, target, silent) == taken.manifest

    before, after = rows_of(settings), rows_of(target)
    for name in before.keys() - LEFT_OUT - {"jobs", "events"}:
        assert after[name] == before[name], name
    assert after["sessions"] == []
    (restored_folder,), (folder,) = after["data_folder"], before["data_folder"]
    assert restored_folder["identity"] == read_identity(target.data_folder) != folder["identity"]
    numbers = [event["number"] for event in before["events"]]
    assert after["events"][: len(numbers)] == before["events"]
    mark, given_back = after["events"][len(numbers) :]
    assert (mark["what"], mark["number"]) == (event_kinds.RESTORED, numbers[-1] + NUMBERS_SKIPPED)
    assert (given_back["what"], given_back["job_id"]) == (event_kinds.GIVEN_BACK, running.job_id)
    theirs, ours = files_of(target), files_of(settings)
    ours.pop(f"unfinished/{half.id}")
    assert theirs.pop(f"unfinished/{half.id}")[1] == hashlib.sha256(b"0123").hexdigest()
    assert theirs == ours

    with closing(Store.open(target)) as restored:
        assert restored.keys.good(hash_of(key.secret)) is not None
        assert restored.sessions.find(session) is None
        assert len(restored.schedules.run_due()) == 1
        assert restored.schedules.get(schedule.id).last_run is not None
        assert restored.uploads.begin_part(half.id, 4).upload.offset_bytes == 4
        again = restored.jobs.get(running.job_id)
        assert (again.state, again.losses, again.attempt, again.worker) == (JobState.QUEUED, 0, claim.attempt, None)
        subjects = [finish(restored).job.subject_id for _ in range(3)]
        assert subjects[:3] == [running.id, calibration.id, waiting.id]
        assert restored.scans.get(running.id).state == "ready"
        newer = restored.events.following(given_back["number"])
        assert newer[0].number == given_back["number"] + 1


def test_every_column_has_a_form_in_a_backup():
    known = (String, Integer, Float, Boolean, Date, JSON, UtcDateTime, Ranked, Registered)
    columns = [column for table in Base.metadata.tables.values() for column in table.columns]
    assert [str(column) for column in columns if not isinstance(column.type, known)] == []


@sqlite_alone
def test_a_second_backup_copies_what_is_new_alone(store, settings, work, into):
    first_scan = work()
    twin = store.files.results(job_kinds.INGEST, first_scan) / "twin"
    twin.hardlink_to(twin.with_name("result"))
    first = take_backup(settings, into, silent)
    second_scan = work()
    second = take_backup(settings, into, silent)
    assert first.copied_bytes == sum(entry.size_bytes for entry in read_entries(first.path)) - twin.stat().st_size
    new = {entry.path: entry.size_bytes for entry in read_entries(second.path) if second_scan in entry.path}
    assert len(new) == 2
    assert second.copied_bytes == sum(new.values())
    old = [entry.path for entry in read_entries(first.path)]
    both = [(taken.path / "data" / path).stat().st_ino for path in old for taken in (first, second)]
    assert len(set(both)) == 2, "an upload and a result, whatever their names"

    of_a_wrong_clock = first.path.rename(into / "sawmill-20380119T031407Z")
    assert remove_older(into, 2, second.path) == []
    assert remove_older(into, 1, second.path) == [of_a_wrong_clock], "not the one that was just taken"
    assert backups_in(into) == [second.path]
    assert check_backup(second.path, silent)[1] == []


@pytest.fixture
def syncing(monkeypatch) -> Callable[[Callable[[int], int]], None]:
    """Have a function called in place of Linux's syncfs(2), for no disk loses what was written when it is asked to."""
    return lambda sync: monkeypatch.setattr(whole_files, "_LIBC", SimpleNamespace(syncfs=sync))


@sqlite_alone
def test_a_backup_is_made_durable_as_a_whole_before_it_has_its_name(settings, work, into, syncing, monkeypatch):
    synchronised, flushed = [], []

    def note(_descriptor: int) -> int:
        (part,) = into.glob(".*.partial")
        synchronised.append(((part / MANIFEST_SUM).is_file(), backups_in(into)))
        return 0

    syncing(note)
    monkeypatch.setattr(os, "fsync", flushed.append)
    work()
    flushed.clear()
    first = take_backup(settings, into, silent)
    assert synchronised == [(True, [])]
    few = len(flushed)
    for _ in range(3):
        work()
    flushed.clear()
    second = take_backup(settings, into, silent)
    assert second.manifest.number_of_files == 4 * first.manifest.number_of_files
    assert len(flushed) == few, "no file by itself"


def test_a_disk_that_has_lost_what_was_written_has_no_backup_and_no_restored_service(backup, elsewhere, into, syncing):
    def fail(_descriptor: int) -> int:
        ctypes.set_errno(errno.EIO)
        return -1

    source = StorageSettings(data_folder=backup.parent / "data", database_url=None)
    restore(backup, source, silent)
    syncing(fail)
    with pytest.raises(OSError, match="Input/output error"):
        take_backup(source, into, silent)
    assert list(into.glob("*sawmill-2*")) == []
    with pytest.raises(OSError, match="Input/output error"):
        restore(backup, elsewhere, silent)
    assert list(elsewhere.data_folder.iterdir()) == []


@pytest.mark.dialect
def test_what_is_deleted_meanwhile_is_in_neither_rows_nor_files(store, settings, work, into):
    scans = sorted(work() for _ in range(3))
    steps = []

    def on_progress(_progress):
        steps.append(1)
        if len(steps) == 1:
            store.scans.delete(scans[2])
            steps.append(work())

    taken = take_backup(settings, into, on_progress)
    rows = (taken.path / "rows/scans.jsonl").read_text()
    assert [scan in rows for scan in scans] == [True, True, False]
    assert check_backup(taken.path, silent) == (taken.manifest, [])
    assert taken.manifest.lacking == []
    assert {entry.path.split("/")[1] for entry in read_entries(taken.path) if entry.path.startswith("scans/")} == {
        *scans[:2],
        steps[1],
    }


@sqlite_alone
def test_a_file_that_is_really_missing_is_named_and_keeps_nothing_else_out(store, settings, work, into, elsewhere):
    lost, kept = work(), work()
    shutil.rmtree(store.files.results(job_kinds.INGEST, lost))
    taken = take_backup(settings, into, silent)
    assert taken.manifest.lacking == [f"scans/{lost}"]
    restore(taken.path, elsewhere, silent)
    assert (elsewhere.data_folder / "scans" / kept / "result").is_file()


@pytest.fixture(scope="module")
def one_backup(tmp_path_factory: pytest.TempPathFactory, empty_data: Path) -> Path:
    """Of a service on SQLite with two scans, and the service's own folder beside it."""
    folder = tmp_path_factory.mktemp("one")
    settings = StorageSettings(data_folder=folder / "data", database_url=None)
    shutil.copytree(empty_data, settings.data_folder)
    with closing(Store(settings)) as store:
        scanner = store.scanners.create(ScannerSpec(name="Line 2", constants=ScannerConstants(**CONSTANTS)))
        for number in range(2):
            spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
            store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10))
            claim = store.jobs.claim("test")
            output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
            (output / "scan.h5").write_text(f"line integrals {number}")
            store.jobs.succeed(claim, answer_of(claim.job.kind, RESULTS[job_kinds.INGEST]()), output)
    (folder / "disk").mkdir()
    return take_backup(settings, folder / "disk", silent).path


@pytest.fixture
def backup(one_backup: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(one_backup, tmp_path / one_backup.name))


def some_file(backup: Path) -> Path:
    return next(path for path in sorted((backup / "data").rglob("*")) if path.is_file())


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def replaced_by_link(path: Path) -> None:
    path.rename(path.with_name("aside"))
    path.symlink_to(path.with_name("aside"))


def replaced_by_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (flip, "is damaged: its SHA-256 is"),
        (Path.unlink, "is missing"),
        (lambda path: path.write_bytes(path.read_bytes() + b"x"), "bytes, and the manifest has"),
        (replaced_by_link, "is no file, but a link or a device"),
        (replaced_by_pipe, "is no file, but a link or a device"),
    ],
    ids=["flipped", "missing", "longer", "link", "pipe"],
)
def test_damage_is_found_and_named_and_never_restored(backup, elsewhere, damage, words):
    path = some_file(backup)
    damage(path)
    (sentence, *_) = check_backup(backup, silent)[1]
    assert sentence.startswith(f"{path.relative_to(backup)} ") or "aside" in sentence
    assert any(words in each for each in check_backup(backup, silent)[1])
    with pytest.raises(Damaged):
        restore(backup, elsewhere, silent)
    assert list(elsewhere.data_folder.rglob("*")) == []


def test_a_second_name_of_another_file_is_damage_too(backup, elsewhere):
    first, second = sorted((backup / "data/scans").rglob("scan.h5"))
    second.unlink()
    second.hardlink_to(first)
    with pytest.raises(Damaged, match=f"{second.relative_to(backup)} is damaged: its SHA-256 is"):
        restore(backup, elsewhere, silent)


@pytest.mark.parametrize("name", [MANIFEST, MANIFEST_SUM, FILES, "rows/jobs.jsonl"])
def test_a_flipped_bit_in_what_tells_of_the_files_is_found_too(backup, name):
    flip(backup / name)
    with pytest.raises(Damaged, match=f"{name}"):
        check_backup(backup, silent)


def test_a_file_too_many_is_named(backup):
    (backup / "data" / "scans" / "more").write_text("")
    assert check_backup(backup, silent)[1] == ["data/scans/more is not in the manifest"]


def sign(backup: Path, change: Callable[[dict[str, Any]], None] = lambda _: None) -> None:
    """Make sums right again, as somebody can who made the backup himself."""
    manifest = json.loads((backup / MANIFEST).read_text())
    for part in (manifest["files"], *manifest["tables"].values()):
        name = next((f"rows/{name}.jsonl" for name, table in manifest["tables"].items() if table is part), FILES)
        content = (backup / name).read_bytes()
        part["sha256"], part["size_bytes"] = hashlib.sha256(content).hexdigest(), len(content)
    change(manifest)
    (backup / MANIFEST).write_text(json.dumps(manifest))
    (backup / MANIFEST_SUM).write_text(hashlib.sha256((backup / MANIFEST).read_bytes()).hexdigest())


def test_a_table_that_leaves_the_backup_is_refused(backup, elsewhere):
    sign(backup, lambda manifest: manifest["tables"].update({"../../evil": manifest["tables"]["jobs"]}))
    with pytest.raises(Damaged, match=r"manifest.json is none of a backup: .*tables"):
        restore(backup, elsewhere, silent)


@pytest.mark.parametrize(
    "path", ["../evil", "/etc/evil", "scans/../../evil", "scans", "scans//evil", "sawmill.db", "scans/a\0b", 7]
)
def test_a_path_that_leaves_the_data_folder_is_refused(backup, elsewhere, path):
    line = json.dumps({"path": path, "size_bytes": 0, "mtime_ns": 0, "sha256": hashlib.sha256(b"").hexdigest()})
    (backup / FILES).write_text(f"{line}\n")
    sign(backup)
    with pytest.raises(Damaged, match=r"line 1 of files.jsonl names no file of a data folder"):
        restore(backup, elsewhere, silent)
    assert not elsewhere.data_folder.exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda _: '{"id": "x"}\n', "its columns are not those of the table"),
        (lambda _: "[1]\n", "line 1 of rows/scanners.jsonl is no row"),
        (lambda rows: rows.replace("+00:00", "never"), "line 1 of rows/scanners.jsonl is no row"),
    ],
    ids=["columns", "list", "time"],
)
def test_rows_that_are_none_are_refused(backup, empty_data, tmp_path, change, words):
    rows = backup / "rows" / "scanners.jsonl"
    rows.write_text(change(rows.read_text()))
    tables = {"scanners": read_manifest(backup).tables["scanners"]}
    database = Database(make_engine(f"sqlite:///{shutil.copytree(empty_data, tmp_path / 'empty')}/sawmill.db"))
    with (
        closing(SimpleNamespace(close=database.engine.dispose)),
        pytest.raises(Damaged, match=words),
        database.write() as session,
    ):
        read_rows(session.connection(), backup, tables)


@to_each
def test_rows_that_the_database_refuses_leave_nothing(backup, target):
    rows = backup / "rows" / "scanners.jsonl"
    rows.write_text(rows.read_text() * 2)
    sign(backup)
    with pytest.raises(Damaged, match=r"the database refuses line 2 of rows/scanners.jsonl: .*(UNIQUE|unique)"):
        restore(backup, target, silent)
    check_empty(target)
    assert list(target.data_folder.iterdir()) == []


def change_row(backup: Path, table: str, **values: Any) -> None:
    path = backup / "rows" / f"{table}.jsonl"
    row, *others = path.read_text().splitlines()
    path.write_text("\n".join([json.dumps(json.loads(row) | values), *others, ""]))


@pytest.mark.parametrize(
    ("table", "values", "words"),
    [
        ("scans", {"id": "../../../../x"}, "line 1 of rows/scans.jsonl is refused: id: String should match pattern"),
        ("events", {"number": 2**63}, "line 1 of rows/events.jsonl is no row: number must be a whole number of at"),
    ],
    ids=["contract", "column"],
)
def test_a_row_that_does_not_fit_leaves_nothing(backup, elsewhere, table, values, words):
    change_row(backup, table, **values)
    sign(backup)
    with pytest.raises(Damaged, match=words):
        restore(backup, elsewhere, silent)
    assert list(elsewhere.data_folder.iterdir()) == []


@pytest.mark.parametrize("more", ["", "/below"], ids=["twice", "below-a-file"])
def test_a_path_that_two_files_cannot_have_is_refused(backup, elsewhere, more):
    line = json.loads((backup / FILES).read_text().splitlines()[0])
    with (backup / FILES).open("a") as file:
        file.write(json.dumps(line | {"path": line["path"] + more}) + "\n")
    sign(backup)
    with pytest.raises(Damaged, match=f"line 5 of files.jsonl names {line['path']}{more}, where another line has"):
        restore(backup, elsewhere, silent)
    assert not elsewhere.data_folder.exists()


def test_a_backup_of_a_later_version_is_refused(backup, elsewhere):
    sign(backup, lambda manifest: manifest.update(revision="9999", version="7.0.0"))
    with pytest.raises(
        BackupRefused, match=f"version 7.0.0 .* 9999, and this .*{VERSION}, knows .*{newest_revision()}: install"
    ):
        restore(backup, elsewhere, silent)
    sign(backup, lambda manifest: manifest.update(format=2))
    with pytest.raises(Damaged, match="has the format 2, and this version of the software reads 1 alone"):
        read_manifest(backup)


@pytest.mark.dialect
def test_a_backup_of_an_earlier_version_is_brought_up_to_date(empty_url, into, elsewhere, tmp_path):
    database = Database(make_engine(empty_url))
    database.upgrade("0003")
    with database.write() as session:
        session.execute(
            text(
                "INSERT INTO jobs (id, created_at, kind, state, subject_id, attempt, cancel_requested)"
                " VALUES ('old', '2026-03-02 05:00:00', 'ingest', 'running', 'old', 2, false)"
            )
        )
    database.engine.dispose()
    (tmp_path / "old").mkdir()
    taken = take_backup(StorageSettings(data_folder=tmp_path / "old", database_url=empty_url), into, silent)
    assert taken.manifest.revision == "0003"
    restore(taken.path, elsewhere, silent)
    with closing(Store.open(elsewhere)) as restored:
        claim = restored.jobs.claim("test")
    assert (claim.job_id, claim.attempt, claim.job.losses) == ("old", 3, 0)
    assert claim.job.created_at == datetime(2026, 3, 2, 5, tzinfo=UTC)


def test_rows_of_0_1_0_are_restored_and_one_that_cannot_be_brought_up_to_date_leaves_nothing(into, elsewhere, tmp_path):
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path / "old", filter="data")
    taken = take_backup(StorageSettings(data_folder=tmp_path / "old", database_url=None), into, silent)
    assert restore(taken.path, StorageSettings(data_folder=tmp_path / "good", database_url=None), silent) is not None
    change_row(taken.path, "drifts", result={})
    sign(taken.path)
    with pytest.raises(Damaged, match="the rows of revision 0003 cannot be brought up to date: KeyError 'measured'"):
        restore(taken.path, elsewhere, silent)
    assert list(elsewhere.data_folder.iterdir()) == []


def test_what_must_not_be_done_is_refused_in_a_sentence(store, settings, upload, backup, into, elsewhere, full_disk):
    with pytest.raises(BackupRefused, match="lies in the data folder"):
        take_backup(settings, settings.data_folder / "scans", silent)
    with pytest.raises(BackupRefused, match=r"there is no folder .*: make it once"):
        take_backup(settings, into / "none", silent)
    with pytest.raises(BackupRefused, match="there is no service's data in"):
        take_backup(elsewhere, into, silent)
    with pytest.raises(BackupRefused, match=r"is not empty .*: a backup is restored into an empty folder alone"):
        restore(backup, settings, silent)
    with pytest.raises(Damaged, match=r"is no backup of this product: it has no manifest.json"):
        restore(into, elsewhere, silent)
    if settings.database_url is not None:
        with pytest.raises(BackupRefused, match="the database of SAWMILL_DATABASE_URL is not empty"):
            restore(backup, elsewhere.model_copy(update={"database_url": settings.database_url}), silent)
    full_disk(3)
    with pytest.raises(StorageFull, match=r"needs 0.00 GB, and 0.00 GB are free for it where"):
        restore(backup, elsewhere, silent)
    assert list(elsewhere.data_folder.iterdir()) == []
    upload(store)
    with pytest.raises(StorageFull, match="the backup needs"):
        take_backup(settings, into, silent)
    assert backups_in(into) == []
    assert [path.name for path in into.iterdir()] == [".sawmill-backups.lock"]


def killed(call: Call) -> bool:
    """Do it in a fork, which may kill itself; whether it has."""
    child = os.fork()
    if child == 0:
        try:
            call()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def at_turn(turn: int, path: Path | None = None) -> Callable[[Any], None]:
    """Kill this process at the call of that number, of those with this path alone if one is given."""
    turns = [0]

    def die(given: Any) -> None:
        turns[0] += path is None or given == str(path)
        if turns[0] == turn:
            os.kill(os.getpid(), signal.SIGKILL)

    return die


@sqlite_alone
def test_a_killed_backup_leaves_nothing_that_looks_like_one(settings, work, into):
    work()
    assert killed(lambda: take_backup(settings, into, at_turn(3))), "among its files"
    assert backups_in(into) == []
    with at_call("os.rename", at_turn(1), below=into):
        assert killed(lambda: take_backup(settings, into, silent)), "complete, but for its name"
    assert backups_in(into) == []
    assert list(into.glob(".*.partial")) != []
    with at_call("open", at_turn(1, into)):
        assert killed(lambda: take_backup(settings, into, silent)), "before its name is durable"
    (whole,) = backups_in(into)
    assert check_backup(whole, silent)[1] == []
    take_backup(settings, into, silent)
    assert list(into.glob(".*.partial")) == []


def second_file(backup: Path) -> str:
    return [entry.path for entry in read_entries(backup) if entry.sha256 is not None][1]


def unfinished(file: Path) -> Path:
    return file.with_name(f"{file.name}.restoring")


@to_each
def test_a_killed_restore_leaves_nothing_that_starts(one_backup, target):
    source = StorageSettings(data_folder=one_backup.parents[1] / "data", database_url=None)
    folder, file = target.data_folder, target.database_file
    # Among the files; when all rows are written, and not yet in their place; when its mark alone is left.
    moments = {
        "copying": ("open", at_turn(1, folder / RESTORING / "data" / second_file(one_backup))),
        "placing": ("open", at_turn(2, folder)) if file is None else ("os.rename", at_turn(1, unfinished(file))),
        "ending": ("shutil.rmtree", at_turn(1, folder / RESTORING)),
    }
    for name, (call, fault) in moments.items():
        with at_call(call, fault):
            assert killed(lambda: restore(one_backup, target, silent)), name
        assert (target.data_folder / RESTORING).is_dir()
        with pytest.raises(StorageMisconfigured, match="was ended before its end: wait for it, or give it once more"):
            Store.open(target)
        if name == "copying" and target.database_file is not None:
            target.database_file.touch()
            with pytest.raises(BackupRefused, match="is not empty: a backup is restored into an empty database alone"):
                restore(one_backup, target, silent)
            target.database_file.unlink()
    assert restore(one_backup, target, silent) is None, "what was killed last had only its mark left to take away"
    assert files_of(target) == files_of(source)
    assert not (target.data_folder / RESTORING).exists()
    assert rows_of(target)["scans"] == rows_of(source)["scans"]
    Store.open(target).close()
