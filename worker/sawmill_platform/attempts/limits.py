"""What one attempt may take of the machine, set when its job is known: a job that takes more ends alone, and once."""

import os
import resource
from typing import NamedTuple

from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.kinds import declaration_of

# Private memory of any job. Those that read files of strangers have no more; others have what their sizes need.
DATA_BYTES = 2 * 2**30
# Each core has its threads, whose stacks and arenas are reserved and hardly used; the above has room for this many.
CORES_INCLUDED, DATA_BYTES_A_CORE = 8, 64 * 2**20
# Any file that is written, where the job's sizes do not need more.
FILE_BYTES = 4 * 2**30
OPEN_FILES = 256
# From the signal at the end of a job's processor time to the kill; equal limits would kill it at once.
PROCESSOR_GRACE_S = 60
# A limit that the system can count.
LARGEST = 2**63 - 1


class Limits(NamedTuple):
    """Of one attempt's process.

    Attributes
    ----------
    data_bytes : int
        Of private memory.
    processor_s : int
        On all cores together.
    file_bytes : int
        Of any file that is written.
    """

    data_bytes: int
    processor_s: int
    file_bytes: int


def limits_of(kind: JobKind, *, memory_bytes: int, file_bytes: int, memory_limit_bytes: int | None) -> Limits:
    """The limits of a job.

    Parameters
    ----------
    memory_bytes, file_bytes
        What the job may need by its recorded sizes.
    memory_limit_bytes
        From the settings; null: what the kind and the sizes give.
    """
    threads = DATA_BYTES_A_CORE * max(cores() - CORES_INCLUDED, 0)
    return Limits(
        data_bytes=memory_limit_bytes or max(DATA_BYTES, memory_bytes) + threads,
        processor_s=processor_s(kind),
        file_bytes=max(FILE_BYTES, file_bytes),
    )


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0))


def processor_s(kind: JobKind) -> int:
    """Processor time of a job of a kind, on all cores together."""
    return cores() * declaration_of(kind).processor_s


def keep_to(limits: Limits) -> None:
    """Hold this process to its limits, as far as it is not held to less already."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    end_s = int(used.ru_utime + used.ru_stime) + limits.processor_s
    _limit(resource.RLIMIT_DATA, limits.data_bytes)
    _limit(resource.RLIMIT_FSIZE, limits.file_bytes)
    _limit(resource.RLIMIT_NOFILE, OPEN_FILES)
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_CPU, end_s, hard=end_s + PROCESSOR_GRACE_S)


def peak_memory_bytes() -> int:
    """The most memory that this process has held so far, pages that it shares with others included."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # Linux counts in KiB


def _limit(what: int, soft: int, *, hard: int | None = None) -> None:
    _, allowed = resource.getrlimit(what)
    most = LARGEST if allowed == resource.RLIM_INFINITY else allowed
    resource.setrlimit(what, (min(soft, most), min(soft if hard is None else hard, most)))
