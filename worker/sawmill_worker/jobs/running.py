"""Which functions do which kind of job: those of the module that has the kind's name.

`jobs/<kind>.py` holds `run(attempt)`, which leaves its files in the attempt's output folder and returns the JSON
answer, and `needs(attempt)`, the memory and the largest file that it may take. This module is the `Work` that the
process of an attempt is given (`sawmill_platform.attempts.work`).
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, cast

# Here too, so that a process that is kept ready has loaded what the science and the readers import when they use it.
import scipy.fft
import scipy.ndimage
import scipy.sparse
import scipy.special  # noqa: F401
import tifffile  # noqa: F401

from sawmill_contracts import job_kinds
from sawmill_contracts.handed_over import HandedOver
from sawmill_formats import hdf5_chunks
from sawmill_platform.attempts.work import Needs
from sawmill_platform.contracts.jobs import Job, JobKind
from sawmill_tomography import warm_up as science
from sawmill_tomography.kernel_cache import only_read
from sawmill_vocabulary import ProgressCallback
from sawmill_worker.jobs import reconstruct
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.use_cases.failures import input_errors_translated


class _JobModule(Protocol):
    def run(self, attempt: Attempt) -> dict[str, Any]: ...

    def needs(self, attempt: Attempt) -> Needs: ...


def _module_of(kind: JobKind) -> _JobModule:
    return cast("_JobModule", import_module(f"sawmill_worker.jobs.{kind.replace('-', '_')}"))


# At import, so that a process that is kept ready has everything loaded.
_MODULES: Mapping[JobKind, _JobModule] = MappingProxyType({kind: _module_of(kind) for kind in JobKind.all()})


def warm_up() -> None:
    """Load or compile the kernels that every job needs: those of the science, and those of packed files."""
    science.warm_up()
    hdf5_chunks.load_kernels()


def attempt(
    job: Job,
    given_json: str,
    output: Path,
    report: ProgressCallback,
    announce: Callable[[Sequence[str]], None],
) -> Attempt:
    """Return the attempt, with the rows that it was handed."""
    return Attempt(job, HandedOver.model_validate_json(given_json), output, report, announce)


def run(attempt: Attempt) -> dict[str, Any]:
    """Do the job.

    Raises
    ------
    sawmill_platform.contracts.attempts.JobFailure
        The input cannot be used; its sentence tells why. Everything else that escapes is ours.
    """
    with input_errors_translated():
        return _MODULES[attempt.job.kind].run(attempt)


def make_ready(attempt: Attempt) -> None:
    """Compile what `run` needs beyond what is warm; from then on no kernel is kept in the cache."""
    if attempt.job.kind is job_kinds.RECONSTRUCT:
        reconstruct.make_ready(attempt)
    only_read()


def needs_of(attempt: Attempt) -> Needs:
    """Return what the job may need.

    Raises
    ------
    sawmill_platform.contracts.attempts.JobFailure
        What it is about cannot be used.
    """
    with input_errors_translated():
        return _MODULES[attempt.job.kind].needs(attempt)
