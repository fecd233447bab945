"""What an exception says to whoever asked for the job: the one place where it is translated."""

import signal

from worker.contracts.jobs import Failure, FailureKind, JobKind
from worker.storage.errors import StorageFull, StorageUnavailable, says_disk_full

_CRASHES = {signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL}


def failure_of(error: Exception) -> Failure:
    """The failure that an exception stands for; what nobody foresaw is ours and keeps its details for the log."""
    if isinstance(error, StorageFull | StorageUnavailable):
        return Failure(kind=FailureKind.PASSING, code=error.code, detail=str(error))
    if isinstance(error, OSError) and says_disk_full(error):
        detail = "the disk is full: free some space in the data folder and ask again"
        return Failure(kind=FailureKind.PASSING, code=StorageFull.code, detail=detail)
    if isinstance(error, MemoryError):
        detail = "the job needs more memory than this worker may use: ask for fewer rows, fewer views or a smaller size"
        return Failure(kind=FailureKind.INPUT, code="out-of-memory", detail=detail)
    detail = f"the job stopped on an unexpected {type(error).__name__}, which is a defect; see the worker's log"
    return Failure(kind=FailureKind.INTERNAL, code="internal-error", detail=detail)


def died(exit_code: int, kind: JobKind) -> Failure:
    """The failure of an attempt whose process ended without an answer.

    The C readers of HDF5 and MAT files crash on some damaged ones: such a file is at fault, and is not tried again.
    """
    if kind is JobKind.INGEST and -exit_code in _CRASHES:
        detail = "the file is damaged so that reading it crashed the reader; export it again"
        return Failure(kind=FailureKind.INPUT, code="broken-file", detail=detail)
    how = f"signal {-exit_code}" if exit_code < 0 else f"exit code {exit_code}"
    detail = f"the job's process ended with {how} before it had an answer; it may have run out of memory"
    return Failure(kind=FailureKind.PASSING, code="attempt-died", detail=detail)
