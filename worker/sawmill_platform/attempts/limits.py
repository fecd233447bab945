"""Limits of one attempt's process, set when its job is known: a job that exceeds one ends alone, and once."""

import os
import resource
from typing import NamedTuple

from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of

# Private memory of any job. Jobs that read files of strangers have no more; other jobs have what their sizes need.
DATA_BYTES = 2 * 2**30
# Each core has its threads, whose stacks and arenas are reserved and hardly used; DATA_BYTES has room for 8 cores.
CORES_INCLUDED, DATA_BYTES_A_CORE = 8, 64 * 2**20
# Size of any written file, unless the job's sizes need more.
FILE_BYTES = 4 * 2**30
OPEN_FILES = 256
# Time from the signal at the end of a job's processor time to the kill; equal limits would kill the job at once.
PROCESSOR_GRACE_S = 60
# Largest limit that the system can count.
LARGEST = 2**63 - 1


class Limits(NamedTuple):
    """Limits of one attempt's process."""

    data_bytes: int
    processor_s: int
    file_bytes: int


def limits_of(
    kind: JobKind,
    *,
    memory_bytes: int,
    file_bytes: int,
    memory_limit_bytes: int | None,
    on_cores: int | None = None,
) -> Limits:
    """Return the limits of a job.

    Parameters
    ----------
    memory_bytes, file_bytes
        Needs of the job by its recorded sizes.
    memory_limit_bytes
        Limit from the settings; null: the limit that results from the kind and the sizes.
    on_cores
        Number of cores that the job may use; null: the number that this process may use.
    """
    on_cores = on_cores or cores()
    threads = DATA_BYTES_A_CORE * max(on_cores - CORES_INCLUDED, 0)
    return Limits(
        data_bytes=memory_limit_bytes or max(DATA_BYTES, memory_bytes) + threads,
        processor_s=processor_s(kind, on_cores=on_cores),
        file_bytes=max(FILE_BYTES, file_bytes),
    )


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def processor_s(kind: JobKind, *, on_cores: int | None = None) -> int:
    """Return the processor time of a job of a kind, on all cores together; null: the cores of this process."""
    return (on_cores or cores()) * declaration_of(kind).processor_s


def keep_to(limits: Limits) -> None:
    """Set the limits of this process, except limits that are lower already."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    end_s = int(used.ru_utime + used.ru_stime) + limits.processor_s
    _limit(resource.RLIMIT_DATA, limits.data_bytes)
    _limit(resource.RLIMIT_FSIZE, limits.file_bytes)
    _limit(resource.RLIMIT_NOFILE, OPEN_FILES)
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_CPU, end_s, hard=end_s + PROCESSOR_GRACE_S)


def peak_memory_bytes() -> int:
    """Return the largest memory that this process has held so far, including pages that it shares."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # Linux counts in KiB


def _limit(what: int, soft: int, *, hard: int | None = None) -> None:
    _, allowed = resource.getrlimit(what)
    most = LARGEST if allowed == resource.RLIM_INFINITY else allowed
    resource.setrlimit(what, (min(soft, most), min(soft if hard is None else hard, most)))
