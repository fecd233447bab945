"""`sawmill backup`, `restore` and `copy-to-postgresql` as a person gives them, and what the doctor says of backups."""

import shutil
from contextlib import closing
from pathlib import Path

import pytest

from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.files.file_store import LAST_BACKUP
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.sole_service import sole_service
from sawmill_store.store import Store


@pytest.fixture
def data(empty_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SAWMILL_PORT", "0")
    (tmp_path / "disk").mkdir()
    data = Path(shutil.copytree(empty_data, tmp_path / "data"))
    with closing(Store(StorageSettings(data_folder=data))) as store:
        store.keys.create(KeyRequest(name="line 2", scope=Scope.SUBMIT))
    return data


def test_from_the_first_backup_to_the_restored_service(run, data, tmp_path):
    made = [run("backup", tmp_path / "disk", "--data", data) for _ in range(2)]
    first, second = (Path(each.stdout.strip()) for each in made)
    assert "0 files are in it, and 0.00 GB were copied" in made[0].stderr
    last = run("backup", tmp_path / "disk", "--keep", 2, "--data", data)
    assert f"{first} was removed." in last.stderr.replace("\n", "")
    backup = Path(last.stdout.strip())
    assert sorted(path for path in (tmp_path / "disk").iterdir() if path.is_dir()) == [second, backup]
    assert "is whole." in run("restore", backup, "--check").stderr
    new = tmp_path / "new"
    assert "the service may start" in run("restore", backup, "--data", new).stderr
    assert "line 2" in run("key", "list", "--data", new).stdout


def test_a_damaged_backup_is_named_and_not_restored(run, data, tmp_path):
    (data / "examples").mkdir()
    (data / "examples" / "complete").write_text("made")
    backup = Path(run("backup", tmp_path / "disk", "--data", data).stdout.strip())
    (backup / "data/examples/complete").write_text("fake")
    said = run("restore", backup, "--check", code=1).stderr
    assert "data/examples/complete is damaged: its SHA-256 is" in said
    assert "The backup is damaged: 1 in all." in said
    assert "Remove a damaged file from the newest backup" in said
    said = run("restore", backup, "--data", tmp_path / "new", code=1).stderr
    assert said.startswith("Nothing was restored: data/examples/complete is damaged")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["serve.lock"]
    (backup / "data/examples/complete").unlink()
    assert "is whole." in run("restore", run("backup", backup.parent, "--data", data).stdout.strip(), "--check").stderr


def test_a_backup_that_cannot_be_noted_is_there_still(run, data, tmp_path):
    (data / LAST_BACKUP).mkdir()
    made = run("backup", tmp_path / "disk", "--data", data, code=1)
    assert "The backup is whole, but sawmill doctor will not know of it: " in made.stderr
    assert "is whole." in run("restore", made.stdout.strip(), "--check").stderr


def test_a_folder_that_is_served_and_one_that_is_not_there_are_refused(run, data, tmp_path, wrong_use):
    backup = run("backup", tmp_path / "disk", "--data", data).stdout.strip()
    with sole_service(StorageSettings(data_folder=data)):
        assert "is served by process" in run("restore", backup, "--data", data, code=1).stderr
        run("backup", tmp_path / "disk", "--data", data)
    said = run("backup", tmp_path / "none", "--data", data, code=1).stderr
    assert said.startswith("There is no backup: there is no folder")
    assert "Missing argument 'FOLDER'" in wrong_use("backup")


def test_rows_are_copied_from_sqlite_into_the_database_of_the_settings(run, data, postgres_url, monkeypatch):
    assert "set SAWMILL_DATABASE_URL to an empty" in run("copy-to-postgresql", "--data", data, code=1).stderr
    monkeypatch.setenv("SAWMILL_DATABASE_URL", postgres_url)
    with sole_service(StorageSettings(data_folder=data, database_url=None)):
        assert "is served by process" in run("copy-to-postgresql", "--data", data, code=1).stderr
    assert "rows were copied: the service may start" in run("copy-to-postgresql", "--data", data).stderr
    assert "line 2" in run("key", "list", "--data", data).stdout
