"""Failures of attempts that ended unexpectedly: by an exception, a dead process or a limit.

Refusals by the code of a kind of job are translated before, in the package that owns the kind.
"""

import errno
import resource
import signal

from sawmill_platform.attempts.limits import processor_s
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.errors import StorageFull, StorageUnavailable, outage_of

# Defects of a program, which recur with the same input; a kill from outside does not.
_CRASHES = frozenset({signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL})
# A job that exceeded a limit was at fault, whatever else was wrong.
LIMITS_MET = frozenset({"too-long", "file-too-large", "out-of-memory", "too-many-files"})
# Python's message when there is no room for a thread's stack.
_NO_THREAD = "can't start new thread"


def failure_of(error: Exception, kind: JobKind) -> Failure:
    """Return the failure for a job's exception; an unforeseen exception is our fault, and the log has its details."""
    outage = outage_of(error, "the attempt") if isinstance(error, OSError) else error
    if isinstance(outage, StorageFull | StorageUnavailable):
        return Failure(kind=FailureKind.PASSING, code=outage.code, detail=str(outage))
    beyond = _beyond_a_limit(error, kind)
    if beyond is not None:
        return beyond
    detail = f"the job stopped on an unexpected {type(error).__name__}, which is a defect; see the worker's log"
    return Failure(kind=FailureKind.INTERNAL, code="internal-error", detail=detail)


def died(exit_code: int, kind: JobKind) -> Failure:
    """Return the failure of an attempt whose process ended without an answer.

    The C readers of HDF5, MAT and PNG files crash on some damaged files: such a file is at fault. Every other crash is
    a defect. Neither is retried; a process that was killed from outside is.
    """
    number = -exit_code
    if number in _CRASHES:
        how, upload = signal.Signals(number), declaration_of(kind).upload
        if upload is not None:
            return Failure(kind=FailureKind.INPUT, code="broken-file", detail=crashed_reader(upload, how))
        detail = f"the job's process crashed ({how.name}), which is a defect; please report it with the worker's log"
        return Failure(kind=FailureKind.INTERNAL, code="attempt-crashed", detail=detail)
    if number == signal.SIGXCPU:
        return too_long(kind, processor_s(kind), of=" of processor time")
    if number == signal.SIGXFSZ:
        return _too_large(kind)
    end = f"was ended from outside by signal {number}" if exit_code < 0 else f"ended with exit code {exit_code}"
    detail = f"the job's process {end} before it had an answer; the system's log may say why"
    return Failure(kind=FailureKind.PASSING, code="attempt-died", detail=detail)


def crashed_reader(what: str, how: signal.Signals) -> str:
    """Return the sentence about a file whose reader crashed."""
    return (
        f"reading the {what} crashed the reader ({how.name}): it is damaged, or needs more memory than reading may "
        "take; export it again"
    )


def endless_reader(what: str, still_s: float) -> str:
    """Return the sentence about a file whose reader runs in a loop."""
    return f"reading the {what} did not get on for {duration(still_s)}: it is damaged; export it again"


def _beyond_a_limit(error: Exception, kind: JobKind) -> Failure | None:
    """Return the failure of a job that exceeded a process limit (`attempts.limits`); None for other errors."""
    number = error.errno if isinstance(error, OSError) else None
    if isinstance(error, MemoryError) or number == errno.ENOMEM or str(error) == _NO_THREAD:
        limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
        than = "there is" if limit == resource.RLIM_INFINITY else f"the {limit / 2**30:.3g} GiB that it may take"
        detail = f"the job needs more memory than {than}: {declaration_of(kind).lighter}"
        return Failure(kind=FailureKind.INPUT, code="out-of-memory", detail=detail)
    if number == errno.EFBIG:
        return _too_large(kind)
    if number == errno.EMFILE:
        most, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        detail = f"the job needs more than the {most} open files that it may have: give a file of fewer parts"
        return Failure(kind=FailureKind.INPUT, code="too-many-files", detail=detail)
    return None


def too_long(kind: JobKind, limit_s: float, *, of: str = "") -> Failure:
    """Return the failure of an attempt that used all its time."""
    detail = f"the job needs more than the {duration(limit_s)}{of} that it may take: {declaration_of(kind).lighter}"
    return Failure(kind=FailureKind.INPUT, code="too-long", detail=detail)


def stalled(still_s: float, stage: str | None) -> Failure:
    """Return the failure of an attempt whose process runs and makes no progress."""
    where = "before its first stage" if stage is None else f"in the stage {stage!r}"
    detail = f"the job hung: nothing moved for {duration(still_s)} {where}, and its process was ended"
    return Failure(kind=FailureKind.PASSING, code="attempt-stalled", detail=detail)


def not_begun(still_s: float) -> Failure:
    """Return the failure of an attempt whose process was given a job and never started it."""
    detail = f"the job's process sent nothing for {duration(still_s)} after it was given the job, and was ended"
    return Failure(kind=FailureKind.PASSING, code="attempt-stalled", detail=detail)


def duration(seconds: float) -> str:
    """Format a duration in hours, minutes or seconds."""
    for unit, length_s in (("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length_s:
            return f"{seconds / length_s:.3g} {unit}"
    return f"{seconds:.3g} seconds"


def _too_large(kind: JobKind) -> Failure:
    detail = f"the job writes a larger file than it may: {declaration_of(kind).lighter}"
    return Failure(kind=FailureKind.INPUT, code="file-too-large", detail=detail)
