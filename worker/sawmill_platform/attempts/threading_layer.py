"""Numba's threads in a process that forks: only TBB's threads survive a fork.

GNU OpenMP, which Numba uses otherwise, ends a child whose parent has run, or only loaded, a parallel kernel; the third
layer, `workqueue`, may not be entered by two threads at once.
"""

import ctypes
import os
import platform
from collections.abc import MutableMapping
from pathlib import Path

LIBRARY = "libtbb.so.12"
LAYER = "NUMBA_THREADING_LAYER"


def tbb_library() -> Path | None:
    """Return the path of the library of the wheel `tbb`; None if it is missing, cannot be loaded or is not selected."""
    from importlib.metadata import PackageNotFoundError, files  # noqa: PLC0415 - a fifth of the start of a command

    if platform.machine() != "x86_64" or os.environ.get(LAYER, "tbb") != "tbb":
        return None
    try:
        found = next((Path(str(file.locate())) for file in files("tbb") or () if file.name == LIBRARY), None)
        if found is not None:
            ctypes.CDLL(str(found))
    except (PackageNotFoundError, OSError):
        return None
    return found


def configure_threads(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set the variables that libraries read when they are loaded, unless they are set already.

    OpenBLAS has one thread: the matrices are so small that its threads wait longer for each other than they compute,
    which doubled the processor time of a job with a small input.
    """
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")


def load(library: Path) -> None:
    """Load TBB before Numba searches for it at its first parallel kernel: Numba does not search the wheel's folder."""
    ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
