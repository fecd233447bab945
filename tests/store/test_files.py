"""Folders and files are whole or not there, and a result is opened once its content is the one that its job wrote."""

import errno
import os
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from sawmill_contracts import kinds
from sawmill_platform.errors import DamagedResult, NotFound, StorageFull, disk_outage_reported
from sawmill_platform.files.file_store import IDENTITY, FileStore
from sawmill_platform.files.verified_results import VerifiedResults, compute_digest

LOCK = threading.Lock()


@pytest.fixture
def files(tmp_path):
    store = FileStore(tmp_path)
    store.make_folders()
    (tmp_path / IDENTITY).write_text("of a test")
    return store


def incoming(files):
    return list((files.folder / "incoming").iterdir())


def test_what_is_made_on_request_is_made_once_and_whole_or_not_at_all(files):
    folder = files.results(kinds.CALIBRATE, "found")
    folder.mkdir()
    with pytest.raises(ZeroDivisionError):
        files.kept(kinds.CALIBRATE, "found", "report.png", lambda: bytes(1 // 0), one_at_a_time=LOCK)
    assert list(folder.iterdir()) == []
    for content in (b"drawn", b"drawn again"):
        path = files.kept(
            kinds.CALIBRATE, "found", "report.png", lambda content=content: content, one_at_a_time=threading.Lock()
        )
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


def test_a_full_disk_is_reported_and_leaves_nothing_and_other_trouble_is_not_called_full(files):
    def chunks():
        yield b"ab"
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(StorageFull, match="the disk is full: the upload was given up"):
        files.receive(chunks(), max_bytes=10)
    assert incoming(files) == []
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


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "volume.h5"
    path.write_bytes(b"as its job wrote it")
    while time.time() < path.stat().st_ctime + 0.15:  # a result is older than a tick of the file system's clock
        time.sleep(0.02)
    return path


class Rows:
    """Rows of jobs, and the number of times that a digest was compared, a file read apart and a digest noted."""

    def __init__(self, path, *, noted=True):
        self.sha256 = compute_digest(path) if noted else None
        self.compared = self.read = 0

    def noted(self, _):
        self.compared += 1
        return self.sha256

    def read_apart(self, path):
        self.read += 1
        if path.read_bytes() != b"as its job wrote it":
            raise DamagedResult(path.name, "its reader crashed")

    def note(self, _, sha256):
        self.sha256 = sha256

    def results(self, **limits):
        return VerifiedResults(self.noted, self.read_apart, self.note, **limits)


def change(path, content):
    """Replace the content, and keep size, name and time of change."""
    before = path.stat()
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)


def test_a_file_is_compared_once_in_a_process_and_again_after_a_change_that_keeps_its_time(path):
    rows = Rows(path)
    results, other_process = rows.results(), rows.results()
    assert [results.digest(path) for _ in range(3)] == [rows.sha256] * 3
    assert rows.compared == 1
    other_process.digest(path)
    assert rows.compared == 2
    change(path, b"as its disk made it")
    for _ in range(2):
        with pytest.raises(DamagedResult, match="its digest is not the one that was taken"):
            results.digest(path)
    path.write_bytes(b"as its job wrote it")
    assert results.digest(path) == rows.sha256


def test_a_result_without_a_digest_is_read_apart_once_and_noted(path):
    rows = Rows(path, noted=False)
    sha256 = rows.results().digest(path)
    assert (rows.sha256, rows.read) == (sha256, 1)
    rows.results().digest(path)
    assert rows.read == 1
    rows.sha256 = None
    change(path, b"as its disk made it")
    with pytest.raises(DamagedResult, match="its reader crashed"):
        rows.results().digest(path)
    assert rows.sha256 is None


def test_one_thread_reads_a_file_that_many_want(path):
    class Slow(Rows):
        def noted(self, path):
            begun.wait(60)
            return super().noted(path)

    begun, rows = threading.Event(), Slow(path)
    results = rows.results()
    with ThreadPoolExecutor(8) as pool:
        digests = [pool.submit(results.digest, path) for _ in range(8)]
        begun.set()
    assert {each.result() for each in digests} == {rows.sha256}
    assert rows.compared == 1


def test_no_more_files_are_kept_in_mind_than_fit_and_a_pipe_and_a_link_are_not_opened(path):
    rows, other = Rows(path), path.with_name("other.h5")
    results = rows.results(most_files=1)
    other.write_bytes(path.read_bytes())
    for each in (path, other, path):
        results.digest(each)
    assert rows.compared == 3
    os.mkfifo(path.with_name("pipe"))
    path.with_name("link").symlink_to(path)
    for name in ("pipe", "link"):
        with pytest.raises(DamagedResult, match="it is a link, a pipe"):
            Rows(path).results().digest(path.with_name(name))
