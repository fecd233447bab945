"""Declaration of a kind of job: its request, answer, storage and limits, in one value for each kind.

`JobKind` (`sawmill_contracts/jobs.py`) is the table: one line names a kind and its plural. These two names give the
places of everything else:

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

from sawmill_contracts.jobs import JobKind
from sawmill_contracts.keys import Scope
from sawmill_platform.contracts.base import Contract

Ask = TypeVar("Ask", bound=Contract)
Answer = TypeVar("Answer", bound=Contract)

# Such a file is read in 5 s where 1.4 GB take 27 s (docs/performance.md); a packed one may hold several times as many
# samples.
SHORT_UPLOAD_BYTES = 256 * 2**20


class Reference(StrEnum):
    """Resource that a request refers to. It must be usable; while a job makes it, the new job waits for that job.

    In a declaration a reference follows those that it depends on: a calibration its scan, a theta its scanner.
    """

    SCAN = "scan"
    """`scan_id`; the scan's scanner comes with it."""
    SCANNER = "scanner"
    """`scanner_id`."""
    PHANTOM = "phantom"
    """`phantom_id`, or the phantom that the scan names."""
    CALIBRATION = "calibration"
    """`calibration_id`, or the active one of the scan's scanner; none where the request gives a `theta`."""
    THETA = "theta"
    """`theta`, or the theta of the scanner's active calibration."""


@dataclass(frozen=True)
class Operation:
    """A route as the OpenAPI document describes it; `example` holds the console's values, parameters and `body`."""

    summary: str
    description: str
    example: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class KindDeclaration:
    """Declarations of every kind of job.

    Attributes
    ----------
    kind : JobKind
        Line of the table.
    noun : str
        What a job of this kind works on, in sentences and codes: `plan` gives `plan-not-found`.
    label : str
        Name of the work for people, marked for the catalogues.
    result : type of Contract
        Contract of what `run` returns.
    processor_s : int
        Seconds of processor time for each core that a job may use.
    time_limit_s : int
        Seconds that an attempt may take.
    stall_s : int
        Seconds without progress after which an attempt is stopped: several times the longest normal pause on a slow
        machine (`docs/operations.md#time-and-progress`).
    lighter : str
        What to do about a job that takes too long.
    upload : str or None
        Name, in sentences, of the uploaded file that the job reads. None: there is none.
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
    """A job that reads an uploaded file into a row of a table of its own."""

    upload: str
    processor_s: int = 3600
    time_limit_s: int = 6 * 3600
    stall_s: int = 1800
    lighter: str = "give a smaller file"

    def is_short(self, size_bytes: int) -> bool:
        """Return whether reading a file of this size takes seconds."""
        return size_bytes <= SHORT_UPLOAD_BYTES


@dataclass(frozen=True, kw_only=True)
class AskedKind(KindDeclaration, Generic[Ask, Answer]):
    """A job that a client requests and whose answer is stored. A kind with an upload has a route written by hand.

    Attributes
    ----------
    ask, options : type of Contract
        The body of the request, a `Given`; the part of it that is stored for the job.
    answer
        The contract of the stored thing, or a union of contracts.
    read : callable
        Maps a stored record to the answer (`stored_as`).
    links : type of Contract
        Links to the answer and its files: `self`, `job`, the names of `files`, and references such as `calibration`.
    files : mapping
        A link's name -> its path below /v1/<plural>/<id>/.
    result_file : str or None
        The file that each success leaves in its folder; the other `files` are drawn from it.
    references : tuple of Reference
        References of a request, which are resolved in this order.
    blocks_deletion : bool
        Whether its scanner and its phantom cannot be deleted while it is stored. A scan can, once its job has ended.
    listed_by : tuple of str
        Filters of a list: `state`, and ids of references.
    to_ask, to_list, to_get : Operation
        The routes' texts.
    is_short : callable
        Maps the options to whether the job takes seconds: short jobs wait for no long one. By default no job is short.
    needed_scope : callable
        Maps the request to the scope that a key needs for it: `submit` for work alone.
    asked_at : str or None
        Path of the request, if not /v1/<plural>; the path may contain a reference's id.
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
        """Id of the example: the one in `to_get`, else `example`."""
        return str(self.to_get.example.get(f"{self.noun}_id", "example"))


def stored_as(answer: type[Answer]) -> Callable[[Mapping[str, Any]], Answer]:
    """Read a stored record as a contract whose fields have the record's names."""
    return lambda record: answer.model_validate({name: record[name] for name in answer.model_fields if name in record})


def declaration_of(kind: JobKind) -> KindDeclaration:
    """Return the declaration of a kind."""
    declaration: KindDeclaration = import_module(f"sawmill_contracts.{kind.plural}").DECLARATION
    return declaration


def asked_kinds() -> list[AskedKind[Any, Any]]:
    """Return the declarations of the kinds that clients request, in the table's order."""
    declarations = (declaration_of(kind) for kind in JobKind)
    return [declaration for declaration in declarations if isinstance(declaration, AskedKind)]
