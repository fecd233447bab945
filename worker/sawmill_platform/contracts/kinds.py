"""What a kind of job declares: how it is answered, stored and limited, in one value a kind."""

from dataclasses import dataclass
from importlib import import_module

from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind

# Read in 5 s where 1.4 GB take 27 s (docs/performance.md); a packed one may hold several times as many samples.
SHORT_UPLOAD_BYTES = 256 * 2**20


@dataclass(frozen=True, kw_only=True)
class KindDeclaration:
    """What every kind declares.

    Attributes
    ----------
    kind : JobKind
        Its line of the table.
    noun : str
        What a job of this kind works on, in sentences and codes: `plan` gives `plan-not-found`.
    label : str
        What people call the work, marked for the catalogues.
    result : type of Contract
        What `run` answers with.
    processor_s : int
        Seconds of processor time for each core that a job may use.
    time_limit_s : int
        Seconds that an attempt may take.
    stall_s : int
        Seconds for which its progress may stand still: several times the longest honest silence on a slow machine
        (`docs/operations.md#time-and-progress`).
    lighter : str
        What to do about a job that takes too long.
    upload : str or None
        The name in sentences of the file that somebody sent and the job reads. None: there is none.
    topic : str or None
        The heading under which the history of a job's group keeps the ends of such jobs. None: no history does.
    result_file : str or None
        The file for downloads that each success leaves in its folder. None: there is none.
    """

    kind: JobKind
    noun: str
    label: str
    result: type[Contract]
    processor_s: int
    time_limit_s: int
    stall_s: int
    lighter: str
    upload: str | None = None
    topic: str | None = None
    result_file: str | None = None


@dataclass(frozen=True, kw_only=True)
class UploadedKind(KindDeclaration):
    """A job that reads a file that somebody sent, into a row of a table of its own."""

    upload: str
    processor_s: int = 3600
    time_limit_s: int = 6 * 3600
    stall_s: int = 1800
    lighter: str = "give a smaller file"

    def is_short(self, size_bytes: int) -> bool:
        """Whether reading a file of this size takes seconds."""
        return size_bytes <= SHORT_UPLOAD_BYTES


def declaration_of(kind: JobKind) -> KindDeclaration:
    """Return what a kind declares."""
    declaration: KindDeclaration = import_module(kind.declared_in).DECLARATION
    return declaration
