"""`sawmill doctor` on folders with one thing wrong each, as the person sees it who has to mend that."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from results import CONSTANTS

from sawmill_command.doctor import machine
from sawmill_command.doctor.machine import State
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.backups.taking import Newest
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.errors import StorageMisconfigured
from sawmill_platform.files.file_store import LAST_BACKUP, RESTORING
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.sole_service import refuse_second, serving_process, sole_service
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind
from sawmill_vocabulary.version import VERSION


@pytest.fixture(autouse=True)
def _alone(monkeypatch):
    for name in [name for name in os.environ if name.startswith("SAWMILL_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("SAWMILL_PORT", "0")


@pytest.fixture
def data(empty_data, tmp_path):
    return Path(shutil.copytree(empty_data, tmp_path / "data"))


def findings(run, data, subject=None, *, code=0):
    """What the doctor finds on the folder, of one subject where it is named."""
    found = json.loads(run("doctor", "--data", data, "--json", code=code).stdout)["findings"]
    return [each for each in found if subject in {None, each["subject"]}]


def found(run, data, subject, *, code=1):
    """The one finding of a subject that is not good."""
    (one,) = [each for each in findings(run, data, subject, code=code) if each["state"] != "good"]
    assert one["cure"]
    return one


def test_an_installation_in_order_has_nothing_bad(run, data):
    found = findings(run, data)
    expected = {"settings", "versions", "kernels", "memory", "open files", "user", "confinement", "data folder", "disk"}
    expected |= {"address", "database", "tables", "files", "workers", "clock", "Redis", "webhooks", "backup"}
    assert {finding["subject"] for finding in found} == expected
    assert [each for each in found if each["state"] == "bad"] == []
    (user,) = [each for each in found if each["subject"] == "user"]
    assert user["state"] == ("watch" if os.geteuid() == 0 else "good")
    printed = run("doctor", "--data", data).stdout
    assert "SQLite" in printed
    assert "whole, and of this version" in printed


def test_a_folder_that_is_not_there_is_not_made(run, tmp_path):
    assert "the first start of sawmill serve makes it" in run("doctor", "--data", tmp_path / "none").stdout
    assert not (tmp_path / "none").exists()


def test_who_serves_the_folder_is_named_and_on_postgresql_several_may(run, data):
    with sole_service(StorageSettings(data_folder=data)):
        assert f"process {os.getpid()} serves the data folder" in run("doctor", "--data", data).stdout
        with pytest.raises(StorageMisconfigured, match=f"served by process {os.getpid()} already"):
            refuse_second(StorageSettings(data_folder=data))
    refuse_second(StorageSettings(data_folder=data))
    settings = StorageSettings(data_folder=data, database_url="postgresql://sawmill@db.mill.example/sawmill")
    with sole_service(settings), sole_service(settings):
        refuse_second(settings)


def tables_of(data, revision, version):
    with sqlite3.connect(data / "sawmill.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = ?, product_version = ?", (revision, version))
    connection.close()


def revision_of(data):
    with closing(sqlite3.connect(data / "sawmill.db")) as connection:
        return connection.execute("SELECT version_num FROM alembic_version").fetchone()[0]


@pytest.mark.parametrize(
    ("revision", "version", "tables"),
    [("0012", None, "revision 0012"), ("9999", "9.0.0", "version 9.0.0 (revision 9999)")],
)
def test_a_database_of_no_release_or_of_a_later_one(run, data, revision, version, tables):
    tables_of(data, revision, version)
    finding = found(run, data, "database")
    assert f"tables of {tables}, which this program, version {VERSION}" in finding["sentence"]
    assert finding["cure"].startswith("start the version that wrote them, or restore a backup of a release: ")


LATER = f"has tables of version 9.0.0 (revision 9999), which this program, version {VERSION}"


@pytest.mark.parametrize("command", ["audit", "backup", "key list", "migrate"])
def test_commands_stop_at_tables_of_a_later_version_or_of_no_release(run, data, tmp_path, command):
    tables_of(data, "9999", "9.0.0")
    arguments = [tmp_path] if command == "backup" else []
    ended = run(*command.split(), *arguments, "--data", data, code=1)
    assert LATER in " ".join(ended.stderr.split())
    assert list(tmp_path.glob("sawmill-*")) == [], "no backup"
    tables_of(data, "0020", None)
    ended = run(*command.split(), *arguments, "--data", data, code=1)
    assert f"tables of revision 0020, which this program, version {VERSION}" in " ".join(ended.stderr.split())
    assert revision_of(data) == "0020", "they stay"


@pytest.mark.nightly
@pytest.mark.parametrize("command", ["serve", "worker"])
def test_services_stop_at_tables_of_a_later_version(data, command):
    tables_of(data, "9999", "9.0.0")
    program = [sys.executable, "-m", "sawmill_command.commands", command, "--data", str(data)]
    ended = subprocess.run(program, capture_output=True, text=True, check=False, timeout=120)
    assert ended.returncode == 1
    assert LATER in " ".join(ended.stderr.split())


def test_a_database_of_an_earlier_version_is_not_touched(run, data):
    tables_of(data, "0003", None)
    assert "take a backup" in found(run, data, "database", code=0)["cure"]
    assert revision_of(data) == "0003"


def test_a_damaged_and_a_destroyed_database(run, data):
    connection = sqlite3.connect(data / "sawmill.db")
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'phantoms'").fetchone()
    (size,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    with (data / "sawmill.db").open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(b"\xff" * 64)
    assert "restore the last backup" in found(run, data, "tables")["cure"]
    (data / "sawmill.db").write_bytes(b"no database" * 1000)
    assert "restore the last backup" in found(run, data, "database")["cure"]


def test_files_that_are_lost_are_counted_and_named(run, data):
    with closing(Store(StorageSettings(data_folder=data))) as store:
        spec = ScannerSpec(name="Line 2", constants=ScannerConstants(**CONSTANTS))
        scan = ScanSpec(scanner_id=store.scanners.create(spec).id, data=DataKind.COUNTS)
        ids = [store.scans.accept(scan, store.files.receive([b"scan"], max_bytes=10)).id for _ in range(5)]
    assert "every file that rows name is there" in run("doctor", "--data", data).stdout
    shutil.rmtree(data / "uploads" / "scans" / ids[0])
    for scan_id in ids[1:4]:
        (data / "uploads" / "scans" / scan_id / "original").unlink()
    finding = found(run, data, "files")
    first, second, third = sorted(ids[:4])[:3]
    named = f"uploads/scans/{first}/original, uploads/scans/{second}/original, uploads/scans/{third}/original, ..."
    assert finding["sentence"] == f"4 files that rows name are missing in the data folder: {named}"
    assert "restore the last backup" in finding["cure"]
    shutil.rmtree(data / "uploads" / "scans" / ids[4])
    (data / "uploads" / "scans" / ids[4]).symlink_to(ids[4])
    assert "cannot be read" in found(run, data, "files")["sentence"]


@pytest.mark.parametrize(
    ("name", "value", "subject", "words"),
    [
        ("DATA_FOLDR", "/srv", "settings", "did you mean SAWMILL_DATA_FOLDER?"),
        ("DISK_RESERVE_BYTES", str(10**18), "disk", "it counts as full"),
        ("BROKER_URL", "redis://:secret-word@127.0.0.1:1/0", "Redis", "127.0.0.1 does not answer"),
    ],
)
def test_a_setting_that_is_wrong_or_names_what_is_not_there(run, data, monkeypatch, name, value, subject, words):
    monkeypatch.setenv(f"SAWMILL_{name}", value)
    finding = found(run, data, subject)
    assert words in finding["sentence"]
    assert "secret-word" not in json.dumps(finding)


def test_a_redis_that_refuses_the_password_and_a_server_that_is_away(run, data, monkeypatch, refusing_redis_url):
    monkeypatch.setenv("SAWMILL_BROKER_URL", refusing_redis_url)
    finding = found(run, data, "Redis")
    assert "127.0.0.1 refuses the user or the password" in finding["sentence"]
    assert "SAWMILL_BROKER_URL" in finding["cure"]
    assert "wrong-word" not in json.dumps(finding)
    monkeypatch.setenv("SAWMILL_DATABASE_URL", "postgresql://sawmill@127.0.0.1:1/sawmill")
    assert found(run, data, "database")["cure"] == "start its server, or end the process that holds it"


def test_a_clock_that_is_off(run, data, moved_clock):
    store = Store(StorageSettings(data_folder=data))
    store.database.start_clock()
    store.close()
    moved_clock(ahead_s=7200.0)
    assert "+7200" in found(run, data, "clock", code=0)["sentence"]


def test_who_only_looks_keeps_no_service_from_starting(data):
    settings = StorageSettings(data_folder=data)
    with sole_service(settings):
        pass
    stop = threading.Event()

    def look():
        while not stop.is_set():
            serving_process(settings)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        for _ in range(300):
            with sole_service(settings):
                pass
    finally:
        stop.set()
        thread.join()


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv")
def test_a_folder_of_another_user_is_found_by_one_who_may_not_read_it(data):
    """In a process of its own, without the right that opens everything to root."""
    with sole_service(StorageSettings(data_folder=data)):
        pass
    data.chmod(0o700)
    os.chown(data, 12345, -1)
    rights = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
    command = [*rights, sys.executable, "-m", "sawmill_command.commands", "doctor", "--data", data, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1, done.stderr
    found = {each["subject"]: each for each in json.loads(done.stdout)["findings"] if each["state"] == "bad"}
    assert found["data folder"]["sentence"] == f"{data} belongs to user 12345 and cannot be written to by this one"
    assert found["data folder"]["cure"] == f"run as user 12345, or change the owner: chown -R USER {data}"


@pytest.mark.usefixtures("read_only_disk")
def test_a_disk_that_is_mounted_read_only(run, data):
    finding = found(run, data, "data folder")
    assert "is on a disk that is read-only" in finding["sentence"]
    assert "chown" not in finding["cure"]


def test_a_data_folder_that_is_not_the_database_s_or_whose_identity_cannot_be_read(run, data):
    identity = data / "identity"
    expected = identity.read_text().strip()
    for change in (lambda: identity.write_text("of another service"), identity.unlink):
        change()
        finding = found(run, data, "data folder")
        assert str(data) in finding["sentence"]
        assert f"the database expects the folder with the identity {expected}" in finding["sentence"]
        assert finding["cure"].startswith("mount the folder")
    identity.mkdir()
    unreadable = f"the file 'identity' of the data folder '{data}' cannot be read by this user"
    assert found(run, data, "data folder")["sentence"].startswith(unreadable)


def test_a_data_folder_with_files_and_a_new_database(run, data):
    (data / "sawmill.db").unlink()
    (data / "scans" / "old").mkdir(parents=True)
    assert "has files, and the database is new and knows none of them" in found(run, data, "database")["sentence"]


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give files away")
def test_what_another_user_left_but_for_the_disk_s_own_folder(run, data):
    (data / "lost+found").mkdir()
    os.chown(data / "lost+found", 12345, -1)
    run("doctor", "--data", data)
    os.chown(data / "uploads" if (data / "uploads").exists() else data / "scans", 12345, -1)
    finding = found(run, data, "data folder")
    assert "belongs to user 12345," in finding["sentence"]
    assert finding["cure"].startswith("chown -R ")


@pytest.mark.parametrize(("mode", "code", "change"), [(0o777, 1, "go-w"), (0o755, 0, "o-rwx")])
def test_a_folder_that_others_may_write_to_or_read(run, data, mode, code, change):
    assert data.stat().st_mode & 0o777 == 0o700, "as the service makes it"
    data.chmod(mode)
    assert found(run, data, "data folder", code=code)["cure"] == f"chmod {change} {data}"


def test_a_port_that_is_taken_on_postgresql_perhaps_by_the_service(run, data, monkeypatch):
    with machine.listen("127.0.0.1", 0, guarded=True) as taken:
        assert machine.address(ServiceSettings(port=taken.getsockname()[1]), may_be_ours=True).state is State.GOOD
        monkeypatch.setenv("SAWMILL_PORT", str(taken.getsockname()[1]))
        assert "is taken" in found(run, data, "address")["sentence"]


def test_beyond_loopback_without_a_key(run, data, monkeypatch):
    monkeypatch.setenv("SAWMILL_PUBLIC_URL", "https://calibration.mill.example")
    assert "sawmill key create" in found(run, data, "keys")["cure"]
    store = Store(StorageSettings(data_folder=data))
    store.keys.create(KeyRequest(name="mill", scope=Scope.ADMIN))
    store.close()
    run("doctor", "--data", data)


def test_a_folder_that_may_be_watched_and_is_missing(run, data, tmp_path, monkeypatch):
    monkeypatch.setenv("SAWMILL_WATCH_FOLDERS", json.dumps([str(tmp_path), str(tmp_path / "gone")]))
    assert f"{tmp_path}/gone of SAWMILL_WATCH_FOLDERS is missing" in found(run, data, "watched folders")["sentence"]
    monkeypatch.setenv("SAWMILL_WATCH_FOLDERS", '["scanners"]')
    assert "SAWMILL_WATCH_FOLDERS" in run("doctor", "--data", data, code=1).stdout


def test_kernels_that_were_never_compiled(tmp_path):
    program = "from sawmill_command.doctor.machine import kernels; print(kernels().cure)"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert "run sawmill compile" in done.stdout


def test_a_network_file_system_is_known_by_its_mount(tmp_path):
    mounts = tmp_path / "mountinfo"
    mounts.write_text(
        "22 1 254:0 / / rw - ext4 /dev/vda rw\n"
        f"30 22 0:44 / {tmp_path} rw shared:2 - nfs4 server:/export rw\n"
        f"31 22 0:45 / {tmp_path}-else rw - tmpfs tmpfs rw\n"
    )
    assert machine.file_system(tmp_path / "data", mounts) == "nfs4"
    assert machine.file_system(Path("/usr"), mounts) == "ext4"


@pytest.mark.slow
def test_how_old_the_newest_backup_is(run, data, tmp_path):
    (tmp_path / "disk").mkdir()
    (never,) = findings(run, data, "backup")
    assert (never["state"], "sawmill backup FOLDER" in never["cure"]) == ("watch", True)
    backup = run("backup", tmp_path / "disk", "--data", data).stdout.strip()
    (newest,) = findings(run, data, "backup")
    assert (newest["state"], newest["sentence"]) == ("good", f"the newest is 0.0 days old: {backup}")
    taken_at = datetime.now(UTC) - timedelta(days=9)
    for lacking, state, code in ((0, "watch", 0), (2, "bad", 1)):
        (data / LAST_BACKUP).write_text(Newest(path=backup, taken_at=taken_at, lacking=lacking).model_dump_json())
        (old,) = findings(run, data, "backup", code=code)
        assert (old["state"], "9.0 days old" in old["sentence"]) == (state, True)


def test_a_restore_that_was_killed_is_known(run, data):
    shutil.rmtree(data)
    data.mkdir()
    (data / RESTORING).touch()
    (one,) = [each for each in findings(run, data, code=1) if each["state"] == "bad"]
    assert "was ended before its end" in one["sentence"]
    assert "sawmill restore BACKUP" in one["cure"]
