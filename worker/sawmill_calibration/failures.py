"""Failures that a user can correct, and their causes: here alone errors are translated.

Work that does not fit into the free memory or on the disk is refused before it begins.
"""

import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from sawmill_formats.errors import UnreadableScan
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.base import near_name, placed_complaint, read_strictly
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_platform.errors import DamagedResult
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.geometry.geometry import GeometryError
from sawmill_tomography.phantoms.phantom import PhantomError
from sawmill_tomography.preparing.line_integrals import CountsError
from sawmill_tomography.preparing.row_shifts import RowsError

Held = TypeVar("Held")


class InputError(JobFailure, ValueError):
    """A file, a scan or an option that cannot lead to a result.

    The message is one sentence: which value, and what would be right.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(FailureKind.INPUT, code, sentence)


def refused(code: str, detail: str) -> InputError:
    """Create a failure that the user can correct."""
    return InputError(code, detail)


@contextmanager
def input_errors_translated() -> Iterator[None]:
    """Turn errors of readers and science about unusable input into an `InputError`, with the cause chained."""
    try:
        yield
    except UnreadableScan as error:
        raise _of_file(error) from error
    except (CalibrationError, DamagedResult, DriftError) as error:
        raise refused(error.code, str(error)) from error
    except GeometryError as error:
        raise refused("geometry", str(error)) from error
    except PhantomError as error:
        raise refused("phantom", str(error)) from error
    except RowsError as error:
        raise refused("rows-not-aligned", str(error)) from error
    except CountsError as error:
        raise refused("counts", str(error)) from error


def _of_file(error: UnreadableScan) -> InputError:
    """Convert a reader's error; some libraries report a damaged file when they had no memory to unpack it."""
    limit = limit_bytes()
    if error.code != "broken-file" or limit is None or not ran_short():
        return refused(error.code, str(error))
    return refused(
        "out-of-memory",
        f"reading the file took most of the {limit / 2**30:.3g} GiB of memory that it may take, and failed: it unpacks "
        "to more than that, or is damaged; store it in smaller pieces, or export it again",
    )


def read_json(path: Path, contract: type[Held], *, code: str, otherwise: str) -> Held:
    """Read a contract from a file; a refusal says by this code that the file is `otherwise`, and what is wrong."""
    try:
        held: Held = read_strictly(TypeAdapter(contract), path.read_bytes())
    except ValidationError as error:
        raise refused(code, f"{path.name} is {otherwise}: {placed_complaint(error)}") from error
    return held


def options_of(contract: type[Held], raw_options: object) -> Held:
    """Read options as their contract takes them in JSON, where True is not 1; refuse them with the code `options`."""
    try:
        sent = to_json(raw_options, inf_nan_mode="constants", fallback=_plain)
        options: Held = read_strictly(TypeAdapter(contract), sent)
    except ValidationError as error:
        raise InputError("options", _unknown(contract, error) or placed_complaint(error)) from error
    except ValueError as error:  # half a surrogate, or a list that contains itself
        raise InputError("options", f"an option cannot be read: {error}") from error
    return options


def _unknown(contract: object, error: ValidationError) -> str | None:
    """Return a sentence about the first option that the contract does not have; None if it has all."""
    known = getattr(contract, "model_fields", {})
    names = [str(fault["loc"][0]) for fault in error.errors() if fault["type"] == "extra_forbidden"]
    unknown = [name for name in names if name not in known]
    return f"{unknown[0]} is not a known option{near_name(unknown[0], known)}" if unknown else None


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else repr(value)


# A library that doubles its memory until it suffices holds about half of the limit when it fails
# (tests/worker/execution/test_bombs.py).
RAN_SHORT = 0.4


def limit_bytes() -> int | None:
    """Return the bytes that the process may allocate; None without a limit."""
    limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return None if limit == resource.RLIM_INFINITY else limit


def free_bytes() -> int | None:
    """Return the bytes that the process may still allocate; None without a limit."""
    limit = limit_bytes()
    return None if limit is None else max(limit - _read_sizes()["VmData"], 0)


def ran_short() -> bool:
    """Return whether the peak was so far above the present memory that an allocation may have reached the limit."""
    free, sizes = free_bytes(), _read_sizes()
    return free is not None and sizes["VmHWM"] - sizes["VmRSS"] > RAN_SHORT * free


def _read_sizes() -> dict[str, int]:
    """Read sizes in bytes by the kernel's names: data segment, present memory and peak memory."""
    lines = (line.split(":", 1) for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines())
    return {name: 1024 * int(value.split()[0]) for name, value in lines if name in {"VmData", "VmRSS", "VmHWM"}}


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
            # The file cache counts in `memory.current`, and the kernel frees it when memory is needed.
            lines = dict(line.split() for line in (folder / "memory.stat").read_text(encoding="ascii").splitlines())
            needed = int(used.read_text(encoding="ascii")) - int(lines["inactive_file"])
            yield max(int(limit.read_text(encoding="ascii")) - needed, 0)


def check_memory(needed_bytes: int, available_bytes: int) -> None:
    """Refuse work that does not fit into the memory: `out-of-memory`."""
    if needed_bytes > available_bytes:
        raise refused(
            "out-of-memory",
            f"one slice needs {needed_bytes / GIGABYTE:.3g} GB of memory where {available_bytes / GIGABYTE:.3g} GB may "
            "be used: ask for a smaller size, for a field that holds all that was scanned, or for fewer views",
        )


def check_disk(folder: Path, what: str, shape: tuple[int, int, int], needed_bytes: int, remedy: str) -> None:
    """Refuse a volume (slice, x, y) or a scan (views, rows, detector) too large for a folder's disk: `disk-full`."""
    disk = shutil.disk_usage(folder)
    if needed_bytes > disk.free:
        # A job that fits on the empty disk is tried again later; a job that never fits must be changed by the user.
        raise JobFailure(
            FailureKind.PASSING if needed_bytes <= disk.total else FailureKind.INPUT,
            "disk-full",
            f"{what} of {' x '.join(map(str, shape))} needs up to {needed_bytes / GIGABYTE:.3g} GB and "
            f"{disk.free / GIGABYTE:.3g} GB are free in {folder}: make room, or {remedy}",
        )
