"""Checks of the numerical part: compiled kernels and memory."""

import importlib
import pkgutil
from collections.abc import Iterator

import sawmill_tomography as tomography
from sawmill_calibration.capacity import memory_available
from sawmill_command.doctor.findings import DoctorFinding, State
from sawmill_platform.attempts.limits import DATA_BYTES
from sawmill_tomography.kernel_cache import holds_all


def science() -> Iterator[DoctorFinding]:
    """Check whether a first job would have to compile, and whether the memory suffices for the job."""
    yield kernels()
    available = memory_available()
    sentence = f"{available / 1e9:.1f} GB of memory are free, and a job may take {DATA_BYTES / 1e9:.1f} GB"
    if available < DATA_BYTES:
        yield DoctorFinding("memory", State.WATCH, sentence, "end other programs, or set SAWMILL_WORKERS=1")
    else:
        yield DoctorFinding("memory", State.GOOD, sentence)


def kernels() -> DoctorFinding:
    """Check that the cache has the compiled kernels of this installation."""
    names = [found.name for found in pkgutil.walk_packages(tomography.__path__, f"{tomography.__name__}.")]
    try:
        modules = [importlib.import_module(name) for name in names if name.endswith("_numba")]
    except RuntimeError as error:  # from Numba, if neither the installation nor the user's cache can be written to
        sentence = f"{error}: jobs keep theirs in the data folder, and the first ones wait for them, up to a minute"
        return DoctorFinding("kernels", State.WATCH, sentence, "run sawmill compile as the installation's owner")
    missing = [module.__name__.rpartition(".")[2] for module in modules if not holds_all(module)]
    if missing:
        sentence = f"not compiled yet: {', '.join(missing)}; the first jobs wait for it, up to a minute"
        return DoctorFinding("kernels", State.WATCH, sentence, "run sawmill compile as the service's user")
    return DoctorFinding("kernels", State.GOOD, f"{len(modules)} files of compiled kernels are in the cache")
