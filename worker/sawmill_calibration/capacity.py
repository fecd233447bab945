"""Free memory and disk space, and early refusal of work that does not fit."""

import math
import shutil
from collections.abc import Iterator
from pathlib import Path

from sawmill_calibration.failures import free_bytes, refused
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind

MEMINFO = Path("/proc/meminfo")
CGROUP = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
GIGABYTE = 1e9


def memory_available(meminfo: Path = MEMINFO, cgroup: Path = CGROUP, membership: Path = MEMBERSHIP) -> int:
    """Return the bytes that can be allocated without swapping: the least of machine, control groups and process."""
    lines = dict(line.split(":", 1) for line in meminfo.read_text(encoding="ascii").splitlines())
    machine = int(lines["MemAvailable"].split()[0]) * 1024
    free = free_bytes()
    return min([machine, *_left_in_groups(cgroup, membership), *([] if free is None else [free])])


def _left_in_groups(root: Path, membership: Path) -> Iterator[int]:
    """Yield the bytes left in this process's cgroup (version 2) and in each parent, as far as they have limits."""
    own_group = next((line[3:] for line in membership.read_text().splitlines() if line.startswith("0::")), "/")
    group = root / own_group.lstrip("/")
    # Inside a container the container's own group may be the visible root, under a name that is not visible.
    for folder in {root, group, *(above for above in group.parents if above.is_relative_to(root))}:
        limit, used = folder / "memory.max", folder / "memory.current"
        if limit.is_file() and limit.read_text(encoding="ascii").strip() != "max":
            needed = int(used.read_text(encoding="ascii")) - _reclaimable(folder)
            yield max(int(limit.read_text(encoding="ascii")) - needed, 0)


def _reclaimable(cgroup: Path) -> int:
    """Return the bytes of the file cache, which `memory.current` counts and the kernel frees when memory is needed."""
    lines = dict(line.split() for line in (cgroup / "memory.stat").read_text(encoding="ascii").splitlines())
    return int(lines["inactive_file"])


def check_memory(needed_bytes: int, available_bytes: int) -> None:
    """Refuse work that does not fit into the memory: `out-of-memory`."""
    if needed_bytes > available_bytes:
        raise refused(
            "out-of-memory",
            f"one slice needs {needed_bytes / GIGABYTE:.3g} GB of memory where {available_bytes / GIGABYTE:.3g} GB may "
            "be used: ask for a smaller size, for a field that holds all that was scanned, or for fewer views",
        )


def check_disk(folder: Path, shape: tuple[int, int, int], needed_bytes: int) -> None:
    """Refuse a volume (slice, x, y) that does not fit on the disk of a folder: `disk-full`."""
    slices, size_x, size_y = shape
    remedy = "ask for fewer rows or a smaller size"
    _check_free(folder, f"a volume of {slices} x {size_x} x {size_y}", needed_bytes, remedy)


def check_disk_for_scan(folder: Path, shape: tuple[int, int, int]) -> None:
    """Refuse a scan (views, rows, detector) that does not fit on the disk of a folder: `disk-full`."""
    views, rows, cells = shape
    _check_free(folder, f"a scan of {views} x {rows} x {cells}", 4 * math.prod(shape), "give fewer rows")


def _check_free(folder: Path, what: str, needed_bytes: int, remedy: str) -> None:
    disk = shutil.disk_usage(folder)
    if needed_bytes > disk.free:
        # A job that fits on the empty disk is tried again later; a job that never fits must be changed by the user.
        raise JobFailure(
            FailureKind.PASSING if needed_bytes <= disk.total else FailureKind.INPUT,
            "disk-full",
            f"{what} needs up to {needed_bytes / GIGABYTE:.3g} GB and {disk.free / GIGABYTE:.3g} GB are free in "
            f"{folder}: make room, or {remedy}",
        )
