"""Logs on scanners of fixed pairs: requests, and the answer of the service, the command and Python."""

from pydantic import Field

from sawmill_contracts import kinds
from sawmill_contracts.kinds import AskedKind, JobAnswer, JobLinks, Operation, Reference, stored_as
from sawmill_platform.contracts.base import Contract, Identifier
from sawmill_platform.contracts.given import Given
from sawmill_vocabulary import DataKind
from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.pairs import FEWEST_PAIRS, MOST_PAIRS, LocatedMark, PairAgreement


class LogOnPairs(Contract):
    """The marks of a log, and whether the pairs that it passed still agree."""

    marks: list[LocatedMark] = Field(description="The marks, ordered by height.")
    unplaced: int = Field(description="Number of marks in the pairs' pictures that are in no place.")
    agreement: PairAgreement = Field(description="Whether the pairs still agree.")


class PairLogOptions(Contract):
    """Options of a log on fixed pairs."""

    fixed_pairs_id: Identifier = Field(
        description="Id of the calibration that found the places of the pairs.", examples=["example-pairs"]
    )
    inspection_ids: list[Identifier] = Field(
        min_length=FEWEST_PAIRS,
        max_length=MOST_PAIRS,
        description="Ids of the inspections that received the files: one for each pair, in the order of the "
        "calibration's, with one view, whose rows run along the feed.",
        examples=[["example-log-1", "example-log-2"]],
    )
    data: DataKind = Field(description="Kind of the numbers in all files; never guessed.", examples=["counts"])
    tolerance_mm: float = Field(
        1.0, ge=0.01, le=100, description="The pairs agree where none can have moved by more than this, mm."
    )


class PairLogRequest(PairLogOptions, Given):
    """Request to find the marks of a log that passed a calibrated scanner of fixed pairs."""


class PairLog(JobAnswer[PairLogOptions, LogOnPairs, JobLinks]):
    """A log on fixed pairs in its present state."""


DECLARATION = AskedKind(
    kind=kinds.LOCATE_MARKS,
    noun="pair-log",
    label=N_("Log on fixed pairs"),
    about="Logs that passed a calibrated scanner of fixed pairs: marks in three dimensions, and whether pairs agree.",
    lighter="give files with fewer rows",
    ask=PairLogRequest,
    options=PairLogOptions,
    result=LogOnPairs,
    answer=PairLog,
    read=stored_as(PairLog),
    links=JobLinks,
    references=(Reference.INSPECTION, Reference.FIXED_PAIRS),
    is_short=lambda _: True,
    blocks_deletion=False,
    to_ask=Operation(
        "Find a log's nails and stones on a scanner of fixed pairs",
        "Find what is denser than wood in three dimensions, and whether the pairs still agree. Send each file to "
        "`POST /v1/inspections` first.",
        {
            "body": {
                "fixed_pairs_id": "example-pairs",
                "inspection_ids": ["example-log-1", "example-log-2"],
                "data": "counts",
            }
        },
    ),
    to_list=Operation("List logs on fixed pairs, newest first", "All of them, or a selection by state."),
    to_get=Operation(
        "Get a log on fixed pairs",
        "State of the job, and once it has succeeded the places of the marks.",
        {"pair_log_id": "example-log"},
    ),
)
