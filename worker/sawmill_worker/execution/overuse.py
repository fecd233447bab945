"""What an attempt takes beyond its limits where the system does not count it: shared memory, and its files together."""

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

from sawmill_worker.contracts.jobs import Failure, FailureKind
from sawmill_worker.execution.protocol import Begun
from sawmill_worker.storage.errors import StorageFull, disk_outage_reported
from sawmill_worker.storage.files import checkpoints_of

# Files and folders in the folder of an attempt, and folders in each other: many times what any job writes.
MOST_FILES, DEEPEST = 10_000, 8
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
    private, shared = _memory_bytes(process_id)
    if shared > SMALL_BYTES and private + shared > limits.data_bytes:
        return _too_much("out-of-memory", "private and shared memory", private + shared, limits.data_bytes)
    with disk_outage_reported("looking at a job's files"):
        return _overuse_of_disk(sum(_removed_and_open(process_id)), output, limits, reserve_bytes)


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


def _memory_bytes(process_id: int | None) -> tuple[int, int]:
    """The private memory of a process, as RLIMIT_DATA counts it, and the shared memory, which that leaves out."""
    try:
        lines = Path(f"/proc/{process_id}/status").read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):  # it has ended
        return 0, 0
    status = dict(line.split(":", 1) for line in lines)
    private, shared = (1024 * int(status.get(name, "0").split()[0]) for name in ("VmData", "RssShmem"))
    return private, shared


def _removed_and_open(process_id: int | None) -> Iterator[int]:
    """The bytes of each file that has no name any more and takes its room until it is closed."""
    # A process that has ended has none; another security module may keep even the process's own user out.
    with suppress(FileNotFoundError, ProcessLookupError, PermissionError):
        for descriptor in Path(f"/proc/{process_id}/fd").iterdir():
            with suppress(FileNotFoundError):
                file = descriptor.stat()
                if stat.S_ISREG(file.st_mode) and file.st_nlink == 0:
                    yield file.st_blocks * BLOCK_BYTES


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
