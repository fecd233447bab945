"""Jobs: the row is the job, a message only announces that there is one (docs/architecture.md#jobs)."""

from datetime import datetime
from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field

from sawmill_platform.contracts.base import Contract, Identifier, Stamped, Time
from sawmill_platform.contracts.registered import RegisteredWord
from sawmill_vocabulary import Progress


class JobKind(RegisteredWord):
    """What a worker can be asked to do."""

    plural: str
    declared_in: str

    @classmethod
    def register(cls, name: str, plural: str, *, declared_in: str) -> Self:
        """Add a kind of job.

        Parameters
        ----------
        name, plural
            Of the kind, and of what its jobs work on: both are part of addresses and folders.
        declared_in
            The module that has its `DECLARATION` (`contracts/kinds.py`), imported when it is first needed.
        """
        kind = cls._add(name)
        kind.plural, kind.declared_in = plural, declared_in
        return kind


class JobState(StrEnum):
    """A job's life: queued, running, then one of the three ends."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen."""
        return self in {JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED}


# As conditions on rows need them.
ENDED = tuple(state for state in JobState if state.ended)
UNFINISHED = tuple(state for state in JobState if not state.ended)


class Priority(StrEnum):
    """Which job comes first: somebody waits for it, it is one of many as of a schedule, or it is for idle times."""

    # A line a priority: its name, and its rank in the queue, the lowest first.
    WAITED_FOR = "waited-for", 0
    BATCH = "batch", 1
    BACKGROUND = "background", 2

    rank: int

    def __new__(cls, name: str, rank: int) -> Self:
        """A word that carries the rank."""
        priority = str.__new__(cls, name)
        priority._value_, priority.rank = name, rank
        return priority


class FailureKind(StrEnum):
    """Whose fault an ended job is: the asker's (no retry), passing (retried), or ours (alert)."""

    INPUT = "input"
    PASSING = "passing"
    INTERNAL = "internal"


class Failure(Contract):
    """Why a job failed, in one sentence: which value, and what would be right."""

    kind: FailureKind = Field(
        description="Whose failure it is, and so whether the job is tried again.", examples=["input"]
    )
    code: str = Field(description="Stable, for programs.", examples=["phantom-not-found"])
    detail: str = Field(
        description="One sentence: which value, and what would be right.", examples=["there is no phantom 'cross'"]
    )


class Job(Stamped):
    """A job as it stands."""

    kind: JobKind = Field(description="What it does.", examples=["calibrate"])
    state: JobState = Field(description="Where it is in its life.", examples=["running"])
    subject_id: Identifier = Field(
        description="What it works on, as a scan, a phantom or a calibration.", examples=["example"]
    )
    short: bool = Field(
        default=False,
        description="It takes seconds: it has a lane in which none waits for a long one, as a reconstruction.",
        examples=[True],
    )
    priority: Priority = Field(
        Priority.WAITED_FOR, description="Those waited for go first, those of a batch next.", examples=["waited-for"]
    )
    queue_position: int | None = Field(
        None,
        description="Number of jobs before it in the queue, of a short one those of its lane; null once it runs.",
        examples=[0],
    )
    seconds_left: float | None = Field(
        None,
        ge=0,
        description="About how many seconds until it succeeds: by its progress, and by how long jobs of its kind "
        "took lately, with those before it. Null: nothing is known, or it has ended.",
        examples=[12.0],
    )
    background: Annotated[
        bool, Field(description="As the examples: starts when no other job could, and gives way to one.")
    ] = Field(default=False, examples=[False])
    not_before: Time | None = Field(
        None, description="While it waits to be tried again: the earliest time.", examples=["2026-03-02T05:31:10Z"]
    )
    waiting_for: Failure | None = Field(
        None, description="While it waits to be tried again: the passing failure because of which it does."
    )
    progress: Progress | None = Field(None, description="How far it is. Null: it does not run.")
    attempt: int = Field(
        description="How often it was started; the number tells one attempt from another, and is not limited.",
        examples=[1],
    )
    losses: int = Field(
        0,
        description="Number of attempts that were lost, as by a worker that was killed; the third loss fails the "
        "job. A clean stop of a worker, a full disk and a database that is away are no loss.",
        examples=[0],
    )
    worker: str | None = Field(
        None, description="Host and process of the worker that has it. Null: none has.", examples=["mill:71"]
    )
    cancel_requested: bool = Field(
        default=False,
        description="Whether somebody has cancelled it; a running one ends within seconds.",
        examples=[False],
    )
    request_id: str | None = Field(
        None,
        description="The `X-Request-Id` of the request that queued it; null: none did, as for a schedule's.",
        examples=["0f8b4c6d0d8a4b0e9d0c5b8f3f1e2a77"],
    )
    key_id: str | None = Field(
        None, description="Id of the key that this request brought; null: none.", examples=["0f8b4c6d0d8a4b0e"]
    )
    asked_by: str | None = Field(
        None,
        description="The name of the key with which it was asked for, or who else did; null: an earlier version's.",
        examples=["scanner software of line 2"],
    )
    started_at: datetime | None = Field(
        None,
        description="When its last attempt started, RFC 3339, UTC. Null: it has not started.",
        examples=["2026-03-02T05:31:00Z"],
    )
    finished_at: datetime | None = Field(
        None, description="When it ended, RFC 3339, UTC. Null: it has not ended.", examples=["2026-03-02T05:31:04Z"]
    )
    failure: Failure | None = Field(None, description="Why it failed. Null: it has not.")
