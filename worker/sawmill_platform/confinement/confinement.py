"""Confinement of an attempt's process to its own input, its own folder, and the installation that it runs from.

The process reads strangers' files with libraries in C. An attacker who takes over a library finds nothing to read,
nowhere to write, and nobody to call (docs/understand/decisions/0011-an-attempt-reaches-nothing-but-its-own.md).
"""

import ctypes
import os
import struct
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import structlog

from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.seccomp import refuse_calls
from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.workers.settings import ExecutionSettings

# Libraries, time zones and languages, and the files that give the number of cores and the amount of memory.
SYSTEM = (
    "/usr",
    "/lib",
    "/lib64",
    "/etc/ld.so.cache",
    "/etc/localtime",
    "/dev/urandom",
    "/dev/null",
    "/sys/devices/system",
    "/sys/fs/cgroup",
)
PROC = ("/proc/self", "/proc/meminfo", "/proc/cpuinfo", "/proc/stat", "/proc/sys/vm/overcommit_memory")
# Variables of the folders in which libraries store files.
HOMES = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "MPLCONFIGDIR")
# Folder where Numba stores compiled kernels of a read-only installation; determined before HOME changes.
OWN_KERNELS = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"
# Variables of folders that a user has libraries search.
ASKED_FOR = ("NUMBA_CACHE_DIR", "HDF5_PLUGIN_PATH")
# Rights of root, by the numbers and structures of <linux/capability.h> and <linux/prctl.h>.
NO_NEW_PRIVILEGES, DROP_FROM_BOUNDING_SET, AMBIENT, CLEAR_ALL = 38, 24, 47, 4
CAPABILITIES_VERSION_3 = 0x20080522
# The kernel knows 41; the sets have room for this many.
MOST_CAPABILITIES = 64

_LIBC = ctypes.CDLL(None, use_errno=True)


def move_into(folder: Path) -> None:
    """Make an empty folder and work there; libraries write their own files there, apart from the results."""
    folder.mkdir()
    os.chdir(folder)
    os.environ.update(dict.fromkeys(HOMES, str(folder)))
    tempfile.tempdir = str(folder)


def confine_to(given: AttemptInput, output: Path) -> None:
    """Confine this thread, and threads that it starts, to the job's own files, as far as Landlock and seccomp exist."""
    if landlock.version() > 0:
        landlock.confine([*installation(), given.kept, *given.readable], [output], held=map(Path, PROC))
    _drop_capabilities([(output, os.W_OK | os.X_OK), *((path, os.R_OK) for path in given.readable)])
    refuse_calls()


def _drop_capabilities(needed: Sequence[tuple[Path, int]]) -> None:
    reached = [(path, right) for path, right in needed if os.access(path, right)]
    # All capabilities of this thread and of threads that it starts are dropped for good.
    _LIBC.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    # Refused to a thread that has no capability to drop, and for numbers that the kernel does not know.
    for capability in range(MOST_CAPABILITIES):
        _LIBC.prctl(DROP_FROM_BOUNDING_SET, capability, 0, 0, 0)
    _LIBC.prctl(AMBIENT, CLEAR_ALL, 0, 0, 0)
    # Sets of this thread: effective, permitted and inheritable, each in two halves.
    if _LIBC.capset(struct.pack("=Ii", CAPABILITIES_VERSION_3, 0), struct.pack("=6I", *[0] * 6)) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"capset: {os.strerror(number)}")
    for path, right in reached:
        if not os.access(path, right):
            raise StorageUnavailable(
                f"root's jobs may not use {str(path)!r}: run the service as the user that the data folder belongs to"
            )


@cache
def installation() -> Sequence[Path]:
    """Return the paths that every attempt reads: the system's libraries, Python, the packages and compiled kernels.

    The search takes some milliseconds, once for a template and all its children.
    """
    prefixes = (sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix)
    named = (
        *SYSTEM,
        *prefixes,
        *sysconfig.get_paths().values(),
        *sys.path,
        str(Path(__file__).parents[2]),
        str(OWN_KERNELS),
        *(os.environ.get(name, "") for name in ASKED_FOR),
    )
    # A relative or empty path is the folder in which somebody happened to start the worker.
    there = {Path(path).resolve() for path in named if Path(path).is_absolute() and Path(path).exists()}
    return [path for path in there if not there.intersection(path.parents)]


def say_if_unconfined(settings: ExecutionSettings, user_id: int, landlock_version: int) -> None:
    """Warn of the user root, of attempts not confined to their own files, and of a gap in the kernel's Landlock."""
    if user_id == 0:
        structlog.get_logger().warning(
            "run-as-root", remedy="run the service as a user of its own: see docs/do/install.md"
        )
    found = landlock_version if settings.confine_attempts else 0
    if found < landlock.COMPLETE:
        structlog.get_logger().warning(
            "attempts-confined-in-part" if found else "attempts-not-confined",
            landlock=found,
            complete_from=landlock.COMPLETE,
            remedy="see docs/understand/security.md#confinement",
        )
