"""Private memory of this process: limit, free memory, and whether the memory has run short."""

import resource
from pathlib import Path

STATUS = Path("/proc/self/status")
# A library that doubles its memory until it suffices holds about half of the limit when it fails
# (tests/worker/execution/test_bombs.py).
RAN_SHORT = 0.4


def limit_bytes() -> int | None:
    """Return the bytes that the process may allocate; None without a limit."""
    limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return None if limit == resource.RLIM_INFINITY else limit


def free_bytes(status: Path = STATUS) -> int | None:
    """Return the bytes that the process may still allocate; None without a limit."""
    limit = limit_bytes()
    return None if limit is None else max(limit - _read(status)["VmData"], 0)


def ran_short(status: Path = STATUS) -> bool:
    """Return whether the peak was so far above the present memory that an allocation may have reached the limit."""
    free, sizes = free_bytes(status), _read(status)
    return free is not None and sizes["VmHWM"] - sizes["VmRSS"] > RAN_SHORT * free


def _read(status: Path) -> dict[str, int]:
    """Read sizes in bytes by the kernel's names: data segment, present memory and peak memory."""
    lines = (line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines())
    return {name: 1024 * int(value.split()[0]) for name, value in lines if name in {"VmData", "VmRSS", "VmHWM"}}
