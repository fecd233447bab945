"""What a kind of job declares: how it is asked for, answered, stored and limited, in one value a kind.

`JobKind` (`sawmill_platform/contracts/jobs.py`) is the table: a line a kind, which names the kind and its plural. Everything
else is found by these two names:

contracts/<plural>.py    the contracts, and `DECLARATION`, an `AskedKind` or an `UploadedKind`
jobs/<kind>.py           `run(attempt)`, which does the job, and `needs(attempt)`, its memory and its largest file
/v1/<plural>             an asked kind's routes
<plural>/<id>/           its files in the data folder
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from importlib import import_module
from typing import Any, Generic, TypeVar

from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.keys import Scope

Ask = TypeVar("Ask", bound=Contract)
Answer = TypeVar("Answer", bound=Contract)

# Read in 5 s where 1.4 GB take 27 s (docs/performance.md); a packed one may hold several times as many samples.
SHORT_UPLOAD_BYTES = 256 * 2**20


class Reference(StrEnum):
    """What an ask refers to. It is looked up and must be usable; while a job makes it, the new job waits for that job.

    Those that depend on others follow them in a declaration: a calibration its scan, a theta its scanner.
    """

    SCAN = "scan"
    """`scan_id`; the scan's scanner comes with it."""
    SCANNER = "scanner"
    """`scanner_id`."""
    PHANTOM = "phantom"
    """`phantom_id`, or the phantom that the scan names."""
    CALIBRATION = "calibration"
    """`calibration_id`, or the active one of the scan's scanner; none where the ask gives a `theta`."""
    THETA = "theta"
    """`theta`, or that of the scanner's active calibration."""


@dataclass(frozen=True)
class Operation:
    """A route as the OpenAPI document describes it; `example` holds the console's values, parameters and `body`."""

    summary: str
    description: str
    example: Mapping[str, Any] = field(default_factory=dict)


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


@dataclass(frozen=True, kw_only=True)
class AskedKind(KindDeclaration, Generic[Ask, Answer]):
    """A job that somebody asks for, and whose answer is stored. The route of one with an upload is written by hand.

    Attributes
    ----------
    ask, options : type of Contract
        The body of the request, a `Given`; the part of it that is stored for the job.
    answer
        The contract of the stored thing, or a union of contracts.
    read : callable
        From a stored record to the answer (`stored_as`).
    links : type of Contract
        Where the answer and its files are: `self`, `job`, the names of `files`, and references such as `calibration`.
    files : mapping
        A link's name -> its path below /v1/<plural>/<id>/.
    result_file : str or None
        The file that each success leaves in its folder; the other `files` are drawn from it.
    references : tuple of Reference
        What is looked up when it is asked for, in this order.
    blocks_deletion : bool
        Whether its scanner and its phantom stay as long as it is stored. A scan stays only until its job has ended.
    listed_by : tuple of str
        What a list can be narrowed by: `state`, and references' ids.
    to_ask, to_list, to_get : Operation
        The routes' texts.
    is_short : callable
        From the options to whether the job takes seconds: short jobs wait for no long one. By default none does.
    needed_scope : callable
        From the ask to what a key needs for it: work alone is asked for with `submit`.
    asked_at : str or None
        Where it is asked for, if not at /v1/<plural>; a reference's id may stand in the path.
    tag : str or None
        The group of its routes, if not <plural>.
    """

    ask: type[Ask]
    options: type[Contract]
    answer: Any
    read: Callable[[Mapping[str, Any]], Answer]
    links: type[Contract]
    files: Mapping[str, str] = field(default_factory=dict)
    result_file: str | None = None
    references: tuple[Reference, ...] = ()
    blocks_deletion: bool = True
    listed_by: tuple[str, ...] = ("state",)
    to_ask: Operation
    to_list: Operation
    to_get: Operation
    is_short: Callable[[Any], bool] = lambda _: False
    needed_scope: Callable[[Ask], Scope] = lambda _: Scope.SUBMIT
    asked_at: str | None = None
    tag: str | None = None
    processor_s: int = 24 * 3600
    time_limit_s: int = 24 * 3600
    stall_s: int = 1800
    lighter: str = "ask for fewer rows, fewer views or a smaller size"

    @property
    def example_id(self) -> str:
        """Return the id of the example: that of `to_get`, else `example`."""
        return str(self.to_get.example.get(f"{self.noun}_id", "example"))


def stored_as(answer: type[Answer]) -> Callable[[Mapping[str, Any]], Answer]:
    """Read a stored record as a contract whose fields have the record's names."""
    return lambda record: answer.model_validate({name: record[name] for name in answer.model_fields if name in record})


def declaration_of(kind: JobKind) -> KindDeclaration:
    """What a kind declares."""
    declaration: KindDeclaration = import_module(f"sawmill_contracts.{kind.plural}").DECLARATION
    return declaration


def asked_kinds() -> list[AskedKind[Any, Any]]:
    """The kinds that somebody asks for, in the table's order."""
    declarations = (declaration_of(kind) for kind in JobKind)
    return [declaration for declaration in declarations if isinstance(declaration, AskedKind)]
