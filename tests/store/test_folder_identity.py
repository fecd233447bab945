"""A data folder and its database know each other by an identity: in another folder nothing is done."""

import errno
import os
import shutil
import sqlite3
import tarfile
from contextlib import closing, contextmanager

import pytest
from emptied_databases import ARCHIVE, sqlite_alone
from sqlalchemy import text
from system_calls import at_call, refusing

from sawmill_platform.backups.taking import take_backup
from sawmill_platform.errors import FolderUnavailable, StorageMisconfigured, disk_outage_reported
from sawmill_platform.files.file_store import IDENTITY, FileStore, read_identity
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store


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
    copy = settings.model_copy(update={"data_folder": tmp_path / "copy"})
    with closing(Store.open(copy)) as store:
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
