"""Limits of one attempt's process, set when its job is known: a job that exceeds one ends alone, and once.

The system does not enforce all: the supervisor compares shared memory, threads, and all files together.
"""

import os
import resource
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from sawmill_platform.attempts.protocol import Begun
from sawmill_platform.contracts.attempts import checkpoints_of
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.errors import StorageFull, disk_outage_reported

# Private memory of any job. Jobs that read files of strangers have no more; other jobs have what their sizes need.
DATA_BYTES = 2 * 2**30
# Each core has its threads, whose stacks and arenas are reserved and hardly used; DATA_BYTES has room for 8 cores.
CORES_INCLUDED, DATA_BYTES_A_CORE = 8, 64 * 2**20
# Size of any written file, unless the job's sizes need more.
FILE_BYTES = 4 * 2**30
OPEN_FILES = 256
# Time from the signal at the end of a job's processor time to the kill; equal limits would kill the job at once.
PROCESSOR_GRACE_S = 60
# Largest limit that the system can count.
LARGEST = 2**63 - 1


class Limits(NamedTuple):
    """Limits of one attempt's process."""

    data_bytes: int
    processor_s: int
    file_bytes: int


def limits_of(
    kind: JobKind, *, memory_bytes: int, file_bytes: int, memory_limit_bytes: int | None, on_cores: int | None = None
) -> Limits:
    """Return the limits of a job.

    Parameters
    ----------
    memory_bytes, file_bytes
        Needs of the job by its recorded sizes.
    memory_limit_bytes
        Limit from the settings; null: the limit that results from the kind and the sizes.
    on_cores
        Number of cores that the job may use; null: the number that this process may use.
    """
    on_cores = on_cores or cores()
    threads = DATA_BYTES_A_CORE * max(on_cores - CORES_INCLUDED, 0)
    return Limits(
        data_bytes=memory_limit_bytes or max(DATA_BYTES, memory_bytes) + threads,
        processor_s=processor_s(kind, on_cores=on_cores),
        file_bytes=max(FILE_BYTES, file_bytes),
    )


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def processor_s(kind: JobKind, *, on_cores: int | None = None) -> int:
    """Return the processor time of a job of a kind, on all cores together; null: the cores of this process."""
    return (on_cores or cores()) * declaration_of(kind).processor_s


def keep_to(limits: Limits) -> None:
    """Set the limits of this process, except limits that are lower already."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    end_s = int(used.ru_utime + used.ru_stime) + limits.processor_s
    _limit(resource.RLIMIT_DATA, limits.data_bytes)
    _limit(resource.RLIMIT_FSIZE, limits.file_bytes)
    _limit(resource.RLIMIT_NOFILE, OPEN_FILES)
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_CPU, end_s, hard=end_s + PROCESSOR_GRACE_S)


def peak_memory_bytes() -> int:
    """Return the largest memory that this process has held so far, including pages that it shares."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # Linux counts in KiB


def _limit(what: int, soft: int, *, hard: int | None = None) -> None:
    _, allowed = resource.getrlimit(what)
    most = LARGEST if allowed == resource.RLIM_INFINITY else allowed
    resource.setrlimit(what, (min(soft, most), min(soft if hard is None else hard, most)))


# Files and folders in the folder of an attempt, and folders in each other: many times what any job writes.
MOST_FILES, DEEPEST = 10_000, 8
# Many times the threads that libraries start on all cores; reading more would keep the supervisor from heartbeats.
MOST_THREADS = 2048
# What an attempt may share or write without a check: pages of libraries, the logs of a small job.
SMALL_BYTES = 16 * 2**20
# The unit of `st_blocks` (stat(2)).
BLOCK_BYTES = 512


def overuse(
    process_id: int | None,
    output: Path,
    kind: JobKind,
    limits: Begun,
    *,
    reserve_bytes: int,
    most_threads: int = MOST_THREADS,
) -> Failure | None:
    """Compare an attempt's memory, threads and files with its limits.

    The files of the result together may have the size that one file may have, and so may the checkpoints that have not
    been taken yet.
    """
    threads = _threads(process_id)
    if len(threads) > most_threads:
        detail = f"the job has {len(threads)} threads, and may have {most_threads}"
        return Failure(kind=FailureKind.INPUT, code="out-of-memory", detail=detail)
    private, shared, mapped = _memory(threads)
    if shared > SMALL_BYTES and private + shared > limits.data_bytes:
        return _too_much(kind, "out-of-memory", "private and shared memory", private + shared, limits.data_bytes)
    with disk_outage_reported("looking at a job's files"):
        # A page of it that is mapped keeps all of a file.
        within = f"{output.resolve()}/"
        if any(line.endswith(" (deleted)") and within in line for line in mapped):
            detail = "the job has removed a file that it still maps, so that nobody sees how much of the disk it takes"
            return Failure(kind=FailureKind.INPUT, code="file-too-large", detail=detail)
        return _overuse_of_disk(_removed_and_open(threads), output, kind, limits, reserve_bytes)


def _overuse_of_disk(
    nameless_bytes: int, output: Path, kind: JobKind, limits: Begun, reserve_bytes: int
) -> Failure | None:
    kept, others = 0, nameless_bytes
    for number, (path, size_bytes) in enumerate(_below(output)):
        if number == MOST_FILES or size_bytes is None:
            detail = f"the job may write {MOST_FILES} files, in folders at most {DEEPEST} deep, and has written more"
            return Failure(kind=FailureKind.INPUT, code="too-many-files", detail=detail)
        if checkpoints_of(output) in path.parents:
            kept += size_bytes
        else:
            others += size_bytes
    if max(kept, others) > limits.file_bytes:
        return _too_much(kind, "file-too-large", "disk for its files together", max(kept, others), limits.file_bytes)
    free_bytes = shutil.disk_usage(output).free
    if free_bytes < reserve_bytes and kept + others > SMALL_BYTES:
        raise StorageFull(
            f"the disk has {_size(free_bytes)} free, less than its reserve of {_size(reserve_bytes)}, and the job has "
            f"written {_size(kept + others)}: free some space in the data folder"
        )
    return None


def _threads(process_id: int | None) -> list[Path]:
    """Return a process's threads, as folders in /proc: when the first thread has ended, other ones have the data."""
    with suppress(FileNotFoundError, ProcessLookupError):
        return list(Path(f"/proc/{process_id}/task").iterdir())
    return []


def _memory(threads: list[Path]) -> tuple[int, int, list[str]]:
    """Return a process's memory in bytes, private (as RLIMIT_DATA counts) and shared, and its mappings.

    RLIMIT_DATA does not count the shared memory.
    """
    for thread in threads:
        # An ended thread has no memory; the other exceptions are as in `_removed_and_open`.
        with suppress(FileNotFoundError, ProcessLookupError, PermissionError):
            status = dict(line.split(":", 1) for line in (thread / "status").read_text().splitlines())
            if "VmData" in status:
                private, shared = (1024 * int(status.get(name, "0").split()[0]) for name in ("VmData", "RssShmem"))
                return private, shared, (thread / "maps").read_text(errors="surrogateescape").splitlines()
    return 0, 0, []


def _removed_and_open(threads: list[Path]) -> int:
    """Return the bytes of the files that have no name any more and use room until they are closed."""
    found = {}
    for thread in threads:  # threads may have descriptors that are not shared
        # An ended process has no descriptors; another security module may refuse even the process's own user.
        with suppress(FileNotFoundError, ProcessLookupError, PermissionError):
            for descriptor in (thread / "fd").iterdir():
                with suppress(FileNotFoundError):
                    file = descriptor.stat()
                    if stat.S_ISREG(file.st_mode) and file.st_nlink == 0:
                        found[file.st_dev, file.st_ino] = file.st_blocks * BLOCK_BYTES
    return sum(found.values())


def _below(folder: Path) -> Iterator[tuple[Path, int | None]]:
    """Yield each path below a folder that may be changing, with its bytes; None if it is too deep or closed."""
    waiting = [(folder, 0)]
    while waiting:
        parent, depth = waiting.pop()
        try:
            with os.scandir(parent) as found:
                entries = list(islice(found, MOST_FILES + 1))
        except FileNotFoundError:  # removed since
            continue
        except PermissionError:
            entries, depth = [], DEEPEST + 1
        if depth > DEEPEST:
            yield parent, None
        for entry in entries:
            try:
                size_bytes = entry.stat(follow_symlinks=False).st_blocks * BLOCK_BYTES
            except FileNotFoundError:
                continue
            except PermissionError:
                size_bytes = None
            yield Path(entry.path), size_bytes
            if entry.is_dir(follow_symlinks=False):
                waiting.append((Path(entry.path), depth + 1))


def _too_much(kind: JobKind, code: str, what: str, taken_bytes: int, most_bytes: int) -> Failure:
    detail = (
        f"the job takes {_size(taken_bytes)} of {what}, and may take {_size(most_bytes)}: "
        f"{declaration_of(kind).lighter}"
    )
    return Failure(kind=FailureKind.INPUT, code=code, detail=detail)


def _size(size_bytes: int) -> str:
    return f"{size_bytes / 2**30:.3g} GiB"
