"""Kinds of jobs that clients request: each declares requests, answers and references.

A kind has a name and the plural of what it works on, by which everything else is found:

sawmill_contracts/<plural>.py    the contracts, and `DECLARATION`, an `AskedKind` or an `UploadedKind`
sawmill_worker/jobs/<kind>.py    `run(attempt)`, which does the job, and `needs(attempt)`, its memory and largest file
/v1/<plural>                     the routes of a kind that is asked for
<plural>/<id>/                   its files in the data folder
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Generic, TypeVar

from pydantic import Field

from sawmill_platform.contracts.base import Contract, Identifier, Stamped, link
from sawmill_platform.contracts.jobs import Failure, JobKind, JobState
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.contracts.kind_declarations import KindDeclaration

Ask = TypeVar("Ask", bound=Contract)
Answer = TypeVar("Answer", bound=Contract)
Options = TypeVar("Options", bound=Contract)
Result = TypeVar("Result", bound=Contract)
Links = TypeVar("Links", bound=Contract)


class Reference(StrEnum):
    """Resource that a request refers to. It must be usable; while a job makes it, the new job waits for that job.

    In a declaration a reference follows those that it depends on: a calibration its scan, a theta its scanner.
    """

    SCAN = "scan"  # `scan_id`; the scan's scanner comes with it
    SCANNER = "scanner"  # `scanner_id`
    INSPECTION = "inspection"  # `inspection_ids`; their files stay until the job has ended
    PHANTOM = "phantom"  # `phantom_id`, or the phantom that the scan names
    # `calibration_id`, or the active one of the scan's scanner; none where the request gives a `theta`.
    CALIBRATION = "calibration"
    FIXED_PAIRS = "fixed-pairs"  # `fixed_pairs_id`
    THETA = "theta"  # `theta`, or the theta of the scanner's active calibration


class JobLinks(Contract):
    """Links to related resources."""

    self: str = link("it", "plans/example")
    job: str = link("its job", "jobs/example")


class JobAnswer(Stamped, Generic[Options, Result, Links]):
    """What a client asked for, and the answer once its job has succeeded."""

    state: JobState = Field(description="State of the job.", examples=["succeeded"])
    job_id: Identifier = Field(description="Id of the job that computes the result.", examples=["example"])
    options: Options = Field(description="Options of the request.")
    result: Result | None = Field(None, description="The answer. Null: there is none yet.")
    failure: Failure | None = Field(None, description="Reason of the failure. Null: the job has not failed.")
    links: Links | None = Field(None, description="Links to files and related resources.")


@dataclass(frozen=True)
class Operation:
    """A route as the OpenAPI document describes it; `example` holds the console's values, parameters and `body`."""

    summary: str
    description: str
    example: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class AskedKind(KindDeclaration, Generic[Ask, Answer]):
    """A job that a client requests and whose answer is stored. A kind with an upload has a route written by hand."""

    # ask, options: the body of the request, a `Given`; the part of it that is stored for the job.
    ask: type[Ask]
    options: type[Contract]
    answer: Any  # the contract of the stored thing, or a union of contracts
    read: Callable[[Mapping[str, Any]], Answer]  # maps a stored record to the answer (`stored_as`)
    # Links to the answer and its files: `self`, `job`, the names of `files`, and references such as `calibration`.
    links: type[Contract]
    files: Mapping[str, str] = field(default_factory=dict)  # a link's name -> its path below /v1/<plural>/<id>/
    references: tuple[Reference, ...] = ()  # references of a request, which are resolved in this order
    # Whether its scanner and its phantom cannot be deleted while it is stored. A scan can, once its job has ended.
    blocks_deletion: bool = True
    listed_by: tuple[str, ...] = ("state",)  # filters of a list: `state`, and ids of references
    # to_ask, to_list, to_get: the routes' texts.
    to_ask: Operation
    to_list: Operation
    to_get: Operation
    # Maps the options to whether the job takes seconds: short jobs wait for no long one. By default no job is short.
    is_short: Callable[[Any], bool] = lambda _: False
    # Maps the request to the scope that a key needs for it: `submit` for work alone.
    needed_scope: Callable[[Ask], Scope] = lambda _: Scope.SUBMIT
    asked_at: str | None = None  # path of the request, if not /v1/<plural>; the path may contain a reference's id
    tag: str | None = None  # the group of the routes, if not <plural>
    about: str | None = None  # description of the group <plural> in the public document; None with `tag`
    processor_s: int = 24 * 3600
    time_limit_s: int = 24 * 3600
    stall_s: int = 1800
    lighter: str = "ask for fewer rows, fewer views or a smaller size"

    @property
    def id_name(self) -> str:
        """Name of the parameter of paths that has an id."""
        return f"{self.noun.replace('-', '_')}_id"


def stored_as(answer: type[Answer]) -> Callable[[Mapping[str, Any]], Answer]:
    """Read a stored record as a contract whose fields have the record's names."""
    return lambda record: answer.model_validate({name: record[name] for name in answer.model_fields if name in record})


INGEST = JobKind.register("ingest", "scans")
TRACE_PHANTOM = JobKind.register("trace-phantom", "phantoms")
CALIBRATE = JobKind.register("calibrate", "calibrations")
RECONSTRUCT = JobKind.register("reconstruct", "reconstructions")
PLAN = JobKind.register("plan", "plans")
DRIFT = JobKind.register("drift", "drifts")
INSPECT = JobKind.register("inspect", "inspections")
CALIBRATE_PAIRS = JobKind.register("calibrate-pairs", "fixed-pairs")
LOCATE_MARKS = JobKind.register("locate-marks", "pair-logs")
