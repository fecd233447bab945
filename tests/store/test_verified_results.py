"""A result is opened once its content is the one that its job wrote, whatever its times say."""

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from sawmill_platform.errors import DamagedResult
from sawmill_platform.files.verified_results import VerifiedResults, compute_digest


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


def test_no_more_files_are_kept_in_mind_than_fit(path):
    rows, other = Rows(path), path.with_name("other.h5")
    results = rows.results(most_files=1)
    other.write_bytes(path.read_bytes())
    for each in (path, other, path):
        results.digest(each)
    assert rows.compared == 3


def test_a_pipe_and_a_link_are_not_opened(path):
    os.mkfifo(path.with_name("pipe"))
    path.with_name("link").symlink_to(path)
    for name in ("pipe", "link"):
        with pytest.raises(DamagedResult, match="it is a link, a pipe"):
            Rows(path).results().digest(path.with_name(name))
