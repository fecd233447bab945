"""The private memory of this process: its limit, what is left of it, and whether it has run short."""

import resource
from pathlib import Path

STATUS = Path("/proc/self/status")
# A library that doubles its memory until it is enough has taken half of what there was when that fails.
RAN_SHORT = 0.4


def limit_bytes() -> int | None:
    """What the process may take; None where it has no limit."""
    limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return None if limit == resource.RLIM_INFINITY else limit


def left_bytes(status: Path = STATUS) -> int | None:
    """What it may still take; None where it has no limit."""
    limit = limit_bytes()
    return None if limit is None else max(limit - _read(status)["VmData"], 0)


def ran_short(status: Path = STATUS) -> bool:
    """Whether it has held so much more than now that the next step may have been beyond its limit."""
    left, held = left_bytes(status), _read(status)
    return left is not None and held["VmHWM"] - held["VmRSS"] > RAN_SHORT * left


def _read(status: Path) -> dict[str, int]:
    """The sizes in bytes by the kernel's names: reserved data, in memory now, and at most so far."""
    lines = (line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines())
    return {name: 1024 * int(value.split()[0]) for name, value in lines if name in {"VmData", "VmRSS", "VmHWM"}}
