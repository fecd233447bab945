"""What an attempt takes beyond its limits where the system does not count it: shared memory, and its files together."""

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

from sawmill_platform.attempts.protocol import Begun
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.errors import StorageFull, disk_outage_reported
from sawmill_platform.files.file_store import checkpoints_of

# Files and folders in the folder of an attempt, and folders in each other: many times what any job writes.
MOST_FILES, DEEPEST = 10_000, 8
# Many times what libraries start on all cores; looking at more would keep the supervisor from its heartbeats.
MOST_THREADS = 2048
# What an attempt may share or write without being looked at: pages of libraries, the log of a small job.
SMALL_BYTES = 16 * 2**20
# The unit of `st_blocks` (stat(2)).
BLOCK_BYTES = 512


def overuse(process_id: int | None, output: Path, limits: Begun, *, reserve_bytes: int) -> Failure | None:
    """Compare what an attempt takes with its limits.

    The files of its result together may take what one of them may, and so may the checkpoints that nobody has taken.

    Parameters
    ----------
    process_id
        Of the attempt, which has one process; null: it is not known any more.
    output
        Its folder.
    reserve_bytes
        What should stay free on the disk.

    Returns
    -------
    Failure or None
        None where it takes no more than it may.

    Raises
    ------
    StorageFull
        Less is free on the disk than should be, and the attempt has written some of what is missing.
    FolderUnavailable
        The attempt's folder is gone, or its disk fails.
    """
    threads = _threads(process_id)
    if len(threads) > MOST_THREADS:
        detail = f"the job has {len(threads)} threads, and may have {MOST_THREADS}"
        return Failure(kind=FailureKind.INPUT, code="out-of-memory", detail=detail)
    private, shared, mapped = _memory(threads)
    if shared > SMALL_BYTES and private + shared > limits.data_bytes:
        return _too_much("out-of-memory", "private and shared memory", private + shared, limits.data_bytes)
    with disk_outage_reported("looking at a job's files"):
        # A page of it that is mapped keeps all of a file.
        within = f"{output.resolve()}/"
        if any(line.endswith(" (deleted)") and within in line for line in mapped):
            detail = "the job has removed a file that it still maps, so that nobody sees how much of the disk it takes"
            return Failure(kind=FailureKind.INPUT, code="file-too-large", detail=detail)
        return _overuse_of_disk(_removed_and_open(threads), output, limits, reserve_bytes)


def _overuse_of_disk(nameless_bytes: int, output: Path, limits: Begun, reserve_bytes: int) -> Failure | None:
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
        return _too_much("file-too-large", "disk for its files together", max(kept, others), limits.file_bytes)
    free_bytes = shutil.disk_usage(output).free
    if free_bytes < reserve_bytes and kept + others > SMALL_BYTES:
        raise StorageFull(
            f"the disk has {_size(free_bytes)} free, less than its reserve of {_size(reserve_bytes)}, and the job has "
            f"written {_size(kept + others)}: free some space in the data folder"
        )
    return None


def _threads(process_id: int | None) -> list[Path]:
    """What the kernel tells of each thread: of a process whose first thread has ended, the others tell of it."""
    with suppress(FileNotFoundError, ProcessLookupError):
        return list(Path(f"/proc/{process_id}/task").iterdir())
    return []


def _memory(threads: list[Path]) -> tuple[int, int, list[str]]:
    """The memory of a process: private, as RLIMIT_DATA counts it, shared, which that leaves out, and what is mapped."""
    for thread in threads:
        # A thread that has ended has none; for the rest as in `_removed_and_open`.
        with suppress(FileNotFoundError, ProcessLookupError, PermissionError):
            lines = (thread / "status").read_text().splitlines()
            status = dict(line.split(":", 1) for line in lines)
            if "VmData" in status:
                private, shared = (1024 * int(status.get(name, "0").split()[0]) for name in ("VmData", "RssShmem"))
                return private, shared, (thread / "maps").read_text(errors="surrogateescape").splitlines()
    return 0, 0, []


def _removed_and_open(threads: list[Path]) -> int:
    """The bytes of the files that have no name any more and take their room until they are closed."""
    found = {}
    for thread in threads:  # each may have descriptors of its own
        # A process that has ended has none; another security module may keep even the process's own user out.
        with suppress(FileNotFoundError, ProcessLookupError, PermissionError):
            for descriptor in (thread / "fd").iterdir():
                with suppress(FileNotFoundError):
                    file = descriptor.stat()
                    if stat.S_ISREG(file.st_mode) and file.st_nlink == 0:
                        found[file.st_dev, file.st_ino] = file.st_blocks * BLOCK_BYTES
    return sum(found.values())


def _below(folder: Path) -> Iterator[tuple[Path, int | None]]:
    """What lies below a folder, with its bytes, while somebody works there; None for what is too deep or closed."""
    waiting = [(folder, 0)]
    while waiting:
        parent, depth = waiting.pop()
        try:
            with os.scandir(parent) as found:
                entries = list(islice(found, MOST_FILES + 1))
        except FileNotFoundError:  # removed meanwhile
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


def _too_much(code: str, what: str, taken_bytes: int, most_bytes: int) -> Failure:
    detail = (
        f"the job takes {_size(taken_bytes)} of {what}, and may take {_size(most_bytes)}: ask for fewer rows or a "
        "smaller size"
    )
    return Failure(kind=FailureKind.INPUT, code=code, detail=detail)


def _size(size_bytes: int) -> str:
    return f"{size_bytes / 2**30:.3g} GiB"
