"""Dispatch of a job to the functions of the module that has the name of the job's kind.

`jobs/<kind>.py` holds `run(attempt)`, which writes files to the attempt's output folder and returns the JSON answer,
and `needs(attempt)`, the memory and the largest file that the job may take.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, cast

# Imported here so that a process that is kept ready has loaded the modules that science and readers import on use.
import scipy.fft
import scipy.ndimage
import scipy.sparse
import scipy.special  # noqa: F401
import tifffile  # noqa: F401

from sawmill_calibration.failures import input_errors_translated
from sawmill_contracts import kinds
from sawmill_contracts.declared_kinds import KINDS
from sawmill_contracts.handed_over import HandedOver
from sawmill_formats import hdf5_chunks
from sawmill_platform.attempts.protocol import Needs
from sawmill_platform.contracts.jobs import Job, JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_store.subjects.outputs import check_file
from sawmill_tomography import warm_up as science
from sawmill_tomography.kernel_cache import only_read
from sawmill_vocabulary import ProgressCallback
from sawmill_worker.jobs import reconstruct
from sawmill_worker.jobs.attempt import MillAttempt


class _JobModule(Protocol):
    def run(self, attempt: MillAttempt) -> dict[str, Any]: ...

    def needs(self, attempt: MillAttempt) -> Needs: ...


# Imported when this module is, so that a process that is kept ready has all kinds loaded.
_MODULES: Mapping[JobKind, _JobModule] = MappingProxyType(
    {
        each.kind: cast("_JobModule", import_module(f"sawmill_worker.jobs.{each.kind.replace('-', '_')}"))
        for each in KINDS
    }
)


def warm_up() -> None:
    """Load or compile the kernels that every job needs: the kernels of the science and of packed files."""
    science.warm_up()
    hdf5_chunks.load_kernels()


def attempt(
    job: Job, given_json: str, output: Path, report: ProgressCallback, announce: Callable[[Sequence[str]], None]
) -> MillAttempt:
    """Return the attempt, with the rows that it was handed."""
    return MillAttempt(job, HandedOver.model_validate_json(given_json), output, report, announce)


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Do the job; input that cannot be used is a `JobFailure`, any other exception a defect of the product."""
    with input_errors_translated():
        return _MODULES[attempt.job.kind].run(attempt)


def check(attempt: MillAttempt, answer: dict[str, Any]) -> None:
    """Check the file that an attempt at a job left, which is this attempt's input; raise `InvalidOutput`."""
    kind = attempt.job.kind
    check_file(kind, attempt.given, declaration_of(kind).result.model_validate(answer), attempt.file)


def make_ready(attempt: MillAttempt) -> None:
    """Compile kernels that `run` needs beyond `warm_up`: afterwards the process may not write to the kernel cache."""
    if attempt.job.kind is kinds.RECONSTRUCT:
        reconstruct.make_ready(attempt)
    only_read()


def needs_of(attempt: MillAttempt) -> Needs:
    """Return the memory and the file size that the job may need; a scan, calibration or phantom may be refused."""
    with input_errors_translated():
        return _MODULES[attempt.job.kind].needs(attempt)
