"""The private memory of this process: its limit, how much of it is free, and whether it has run short."""

import resource
from pathlib import Path

STATUS = Path("/proc/self/status")
# A library that doubles its memory until it is enough holds about half of the limit when it fails
# (tests/execution/test_bombs.py).
RAN_SHORT = 0.4


def limit_bytes() -> int | None:
    """What the process may allocate; None where it has no limit."""
    limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return None if limit == resource.RLIM_INFINITY else limit


def free_bytes(status: Path = STATUS) -> int | None:
    """What it may still allocate; None where it has no limit."""
    limit = limit_bytes()
    return None if limit is None else max(limit - _read(status)["VmData"], 0)


def ran_short(status: Path = STATUS) -> bool:
    """Whether its peak was so far above its present memory that the next allocation may have met the limit."""
    free, sizes = free_bytes(status), _read(status)
    return free is not None and sizes["VmHWM"] - sizes["VmRSS"] > RAN_SHORT * free


def _read(status: Path) -> dict[str, int]:
    """Sizes in bytes by the kernel's names: data segment, memory now, and its peak."""
    lines = (line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines())
    return {name: 1024 * int(value.split()[0]) for name, value in lines if name in {"VmData", "VmRSS", "VmHWM"}}
