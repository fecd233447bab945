import asyncio
import errno
import hashlib
import os
import subprocess
from pathlib import Path
from threading import Lock

import pytest

from sawmill_contracts import kinds
from sawmill_platform.errors import NotFound, StorageFull, UploadTooLarge, disk_outage_reported
from sawmill_platform.files.file_store import IDENTITY, FileStore
from sawmill_store.mill_files import MillFiles

LOCK = Lock()


@pytest.fixture
def files(tmp_path: Path) -> FileStore:
    store = FileStore(tmp_path)
    store.make_folders()
    (tmp_path / IDENTITY).write_text("of a test")
    return store


def incoming(files: FileStore) -> list[Path]:
    return list((files.folder / "incoming").iterdir())


def test_an_upload_is_counted_and_hashed(files):
    received = files.receive([b"ab", b"", b"c"], max_bytes=3)
    assert received.path.read_bytes() == b"abc"
    assert (received.size_bytes, received.sha256) == (3, hashlib.sha256(b"abc").hexdigest())


def test_what_is_made_on_request_is_made_once_and_whole_or_not_at_all(files):
    folder = files.results(kinds.CALIBRATE, "found")
    folder.mkdir()
    with pytest.raises(ZeroDivisionError):
        files.kept(kinds.CALIBRATE, "found", "report.png", lambda: bytes(1 // 0), one_at_a_time=LOCK)
    assert list(folder.iterdir()) == []
    for content in (b"drawn", b"drawn again"):
        path = files.kept(kinds.CALIBRATE, "found", "report.png", lambda content=content: content, one_at_a_time=Lock())
        assert (path, path.read_bytes()) == (folder / "report.png", b"drawn")
    assert incoming(files) == []


@pytest.fixture
def nested(files, monkeypatch):
    """An attempt's folder with folders in it deeper than Python's recursion goes, the last one closed to its owner."""
    folder = files.make_attempt_folder("job", 1)
    with monkeypatch.context() as inside:
        inside.chdir(folder)
        for _ in range(1200):
            Path("deeper").mkdir()
            os.chdir("deeper")
        Path("file").touch()
        Path("closed").mkdir(mode=0)
    yield folder
    subprocess.run(["rm", "-rf", files.folder], check=True)  # which pytest could not either


def test_folders_that_were_made_to_stay_are_removed(files, nested):
    files.remove(nested)
    assert list((files.folder / "attempts").iterdir()) == list((files.folder / "removed").iterdir()) == []


def test_what_is_made_for_a_removed_subject_is_not_kept(files):
    with pytest.raises(NotFound):
        files.kept(kinds.CALIBRATE, "gone", "report.png", lambda: b"drawn", one_at_a_time=LOCK)
    assert incoming(files) == []


def test_a_streamed_upload_is_the_same(files):
    async def chunks():
        yield b"ab"
        yield b"c"

    received = asyncio.run(files.receive_stream(chunks(), max_bytes=3))
    assert received.sha256 == hashlib.sha256(b"abc").hexdigest()


def test_an_upload_beyond_its_limit_leaves_nothing(files):
    with pytest.raises(UploadTooLarge, match="larger than the 3 bytes allowed"):
        files.receive([b"ab", b"cd"], max_bytes=3)
    assert incoming(files) == []


def test_an_upload_that_breaks_off_leaves_nothing(files):
    async def chunks():
        yield b"ab"
        raise ConnectionResetError

    with pytest.raises(ConnectionResetError):
        asyncio.run(files.receive_stream(chunks(), max_bytes=10))
    assert incoming(files) == []


def test_a_full_disk_is_reported_and_leaves_nothing(files):
    def chunks():
        yield b"ab"
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(StorageFull, match="the disk is full: the upload was given up"):
        files.receive(chunks(), max_bytes=10)
    assert incoming(files) == []


def test_other_trouble_with_the_disk_is_not_called_full():
    with pytest.raises(PermissionError), disk_outage_reported("a test"):
        raise PermissionError(errno.EACCES, "no")


@pytest.mark.parametrize("identifier", ["..", "a/b", "", "A", "-a", "a" * 65, "a.b"])
def test_an_identifier_cannot_leave_its_folder(files, identifier):
    with pytest.raises(NotFound):
        files.results(kinds.INGEST, identifier)


def test_publishing_replaces_an_older_folder(files):
    final = files.results(kinds.CALIBRATE, "one")
    for attempt in (1, 2):
        output = files.make_attempt_folder("job", attempt)
        (output / f"{attempt}.txt").write_text("result")
        files.publish(output, final)
    assert [path.name for path in final.iterdir()] == ["2.txt"]
    assert list((files.folder / "removed").iterdir()) == []


def test_an_attempt_owns_its_folder_alone(files):
    newer = files.make_attempt_folder("job", 2)
    (newer / "half-written").write_text("")
    late = files.make_attempt_folder("job", 1)
    again = files.make_attempt_folder("job", 2)
    assert list(late.iterdir()) == list(again.iterdir()) == []
    assert len({newer, late, again}) == 3
    files.remove(late)
    assert (newer / "half-written").exists(), "what others write is theirs"


def test_a_result_that_was_not_written_is_not_found(files):
    with pytest.raises(NotFound, match="there is no volume-h5 'one'"):
        MillFiles(files.folder).volume("one")
