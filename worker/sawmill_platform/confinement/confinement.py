"""What the process of an attempt may touch: its own input, its own folder, and the installation it is made of.

It reads strangers' files with libraries in C. Whoever could make one of these do what he wants would find nothing to
read, nowhere to write, and nobody to call (docs/decisions/0011-an-attempt-reaches-nothing-but-its-own.md).
"""

import os
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import structlog

from sawmill_platform.confinement import capabilities, landlock
from sawmill_platform.confinement.seccomp import refuse_calls
from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.workers.settings import ExecutionSettings

# Libraries, the time zones and languages, and what tells how many cores and how much memory there are.
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
# Where libraries put what they want to keep.
HOMES = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "MPLCONFIGDIR")
# Where Numba keeps compiled kernels of an installation that it may not write to; found before there is another home.
OWN_KERNELS = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"
# Folders that somebody asks libraries to look into.
ASKED_FOR = ("NUMBA_CACHE_DIR", "HDF5_PLUGIN_PATH")


def move_into(folder: Path) -> None:
    """Make an empty folder and work there; what libraries write beside the results they write there too."""
    folder.mkdir()
    os.chdir(folder)
    os.environ.update(dict.fromkeys(HOMES, str(folder)))
    tempfile.tempdir = str(folder)


def confine_to(given: AttemptInput, output: Path) -> None:
    """Keep this thread, and those that it starts, to the job's own files, as far as there is Landlock and seccomp.

    Raises
    ------
    StorageUnavailable
        These files can be used by root's capabilities alone, which are gone then.
    """
    if landlock.version() > 0:
        readable = [*installation(), given.kept, *([] if given.file is None else [given.file])]
        landlock.confine(readable, [output], held=map(Path, PROC))
    _drop_capabilities([(output, os.W_OK | os.X_OK), *([] if given.file is None else [(given.file, os.R_OK)])])
    refuse_calls()


def _drop_capabilities(needed: Sequence[tuple[Path, int]]) -> None:
    reached = [(path, right) for path, right in needed if os.access(path, right)]
    capabilities.drop_all()
    for path, right in reached:
        if not os.access(path, right):
            msg = f"root's jobs may not use {str(path)!r}: run the service as the user that the data folder belongs to"
            raise StorageUnavailable(msg)


@cache
def installation() -> Sequence[Path]:
    """What every attempt reads: the system's libraries, Python, the packages and the compiled kernels.

    It takes some milliseconds to find, once for a template and all its children.
    """
    prefixes = (sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix)
    asked_for = (os.environ.get(name, "") for name in ASKED_FOR)
    named = (
        *SYSTEM,
        *prefixes,
        *sysconfig.get_paths().values(),
        *sys.path,
        str(Path(__file__).parents[2]),
        str(OWN_KERNELS),
        *asked_for,
    )
    # One that is relative, or empty, is the folder in which somebody happened to start the worker.
    there = {Path(path).resolve() for path in named if Path(path).is_absolute() and Path(path).exists()}
    return [path for path in there if not there.intersection(path.parents)]


def say_if_unconfined(settings: ExecutionSettings) -> None:
    """Warn of root, and where nothing keeps attempts to their own files or the kernel's Landlock leaves a gap."""
    if os.geteuid() == 0:
        structlog.get_logger().warning(
            "run-as-root", remedy="run the service as a user of its own: see docs/install.md"
        )
    found = landlock.version() if settings.confine_attempts else 0
    if found < landlock.COMPLETE:
        structlog.get_logger().warning(
            "attempts-confined-in-part" if found else "attempts-not-confined",
            landlock=found,
            complete_from=landlock.COMPLETE,
            remedy="see docs/operations.md#what-an-attempt-may-touch",
        )
