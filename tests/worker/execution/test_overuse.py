"""What an attempt takes and no limit of the system counts, in folders and of processes as they are."""

import mmap
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sawmill_contracts.kinds import RECONSTRUCT
from sawmill_platform.attempts.limits import DEEPEST, SMALL_BYTES, overuse
from sawmill_platform.attempts.protocol import Begun
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_platform.errors import FolderUnavailable, StorageFull

MIB = 2**20
FIRST_THREAD_ENDS = """
import ctypes, mmap, os, threading, time

def take():
    shared = mmap.mmap(-1, 2**25)
    shared.write(bytes(2**25))
    file = open("scratch", "wb")
    file.write(bytes(2**21))
    file.flush()
    os.unlink("scratch")
    print("taken", flush=True)
    time.sleep(600)

threading.Thread(target=take).start()
ctypes.CDLL(None).pthread_exit(None)
"""


def looked_at(folder, process=None, *, file_bytes=MIB, data_bytes=2**40, reserve_bytes=0, **limits):
    """What a process with a folder takes beyond its limits; without a process, what the folder does."""
    begun = Begun(data_bytes=data_bytes, file_bytes=file_bytes)
    return overuse(process, folder, RECONSTRUCT, begun, reserve_bytes=reserve_bytes, **limits)


def test_files_count_together_and_checkpoints_apart(tmp_path):
    (tmp_path / "kept").mkdir()
    for name in ("scan.h5", "kept/steps"):
        (tmp_path / name).write_bytes(bytes(MIB * 3 // 4))
    assert looked_at(tmp_path, os.getpid()) is None
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "scratch").write_bytes(bytes(MIB // 2))
    failure = looked_at(tmp_path, os.getpid())
    assert (failure.kind, failure.code) == (FailureKind.INPUT, "file-too-large")
    assert "GiB of disk for its files together, and may take 0.000977 GiB: ask for fewer rows" in failure.detail


def test_a_removed_file_may_not_stay_mapped(tmp_path):
    with (tmp_path / "scratch").open("w+b") as file:
        file.write(bytes(MIB * 3 // 4))
        file.flush()
        mapped = mmap.mmap(file.fileno(), mmap.PAGESIZE)
        assert looked_at(tmp_path, os.getpid()) is None
        (tmp_path / "scratch").unlink()
        failure, words = looked_at(tmp_path, os.getpid()), "the job has removed a file that it still maps"
    assert (failure.code, failure.detail.split(",")[0]) == ("file-too-large", words)
    mapped.close()
    assert looked_at(tmp_path, os.getpid()) is None


def test_a_file_that_is_open_and_has_no_name_counts_and_with_two_descriptors_once(tmp_path):
    with (tmp_path / "scratch").open("wb") as file:
        (tmp_path / "scratch").unlink()
        with os.fdopen(os.dup(file.fileno()), "wb"):
            for size, code in ((MIB * 3 // 4, None), (2 * MIB, "file-too-large")):
                os.pwrite(file.fileno(), bytes(size), 0)
                assert getattr(looked_at(tmp_path, os.getpid()), "code", None) == code
    assert looked_at(tmp_path, os.getpid()) is None


def test_a_process_without_its_first_thread_takes_what_the_others_have(tmp_path):
    """The kernel tells nothing any more of the process by its own number."""
    with subprocess.Popen([sys.executable, "-c", FIRST_THREAD_ENDS], cwd=tmp_path, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline()
        try:
            while "State:\tZ" not in Path(f"/proc/{process.pid}/status").read_text():
                time.sleep(0.01)
            codes = [looked_at(tmp_path, process.pid, data_bytes=limit).code for limit in (MIB, 2**40)]
        finally:
            process.kill()
    assert codes == ["out-of-memory", "file-too-large"]


def test_threads_are_bounded(tmp_path):
    failure = looked_at(tmp_path, os.getpid(), most_threads=0)
    assert failure.code == "out-of-memory"
    assert failure.detail.endswith("threads, and may have 0")


def test_folders_in_folders_are_bounded(tmp_path):
    deep = tmp_path.joinpath(*"d" * DEEPEST)
    deep.mkdir(parents=True)
    assert looked_at(tmp_path, os.getpid()) is None
    (deep / "d").mkdir()
    failure = looked_at(tmp_path, os.getpid())
    assert failure.code == "too-many-files"
    assert failure.detail == "the job may write 10000 files, in folders at most 8 deep, and has written more"


def test_shared_memory_counts_with_private(tmp_path):
    assert looked_at(tmp_path, os.getpid(), data_bytes=MIB) is None, "what the system counts is its to refuse"
    with mmap.mmap(-1, 2 * SMALL_BYTES) as shared:
        shared.write(bytes(2 * SMALL_BYTES))
        assert looked_at(tmp_path, os.getpid()) is None
        assert looked_at(tmp_path, os.getpid(), data_bytes=MIB).code == "out-of-memory"


def test_the_reserve_of_the_disk_is_kept_from_attempts_that_write_much(tmp_path):
    assert looked_at(tmp_path, os.getpid(), reserve_bytes=2**62) is None
    (tmp_path / "scan.h5").write_bytes(bytes(2 * SMALL_BYTES))
    with pytest.raises(StorageFull, match=r"less than its reserve of .* and the job has written 0.03"):
        looked_at(tmp_path, os.getpid(), file_bytes=2**40, reserve_bytes=2**62)


def test_a_folder_that_is_gone_is_an_outage_and_a_process_that_has_ended_takes_its_files_alone(tmp_path):
    with pytest.raises(FolderUnavailable):
        looked_at(tmp_path / "gone")
    assert looked_at(tmp_path) is None
