"""Jobs: the row is the job, a message only announces that there is one (docs/understand/architecture.md#jobs)."""

import difflib
from datetime import datetime
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from sawmill_platform.contracts.base import Contract, Identifier, Stamped, Time
from sawmill_vocabulary import Progress


class RegisteredWord(str):  # noqa: SLOT000 - subclasses have attributes
    """A word of an open set. Each subclass is a set; the public document lists its words as an enumeration."""

    _words: ClassVar[dict[str, Any]]

    def __init_subclass__(cls) -> None:
        cls._words = {}

    @classmethod
    def _add(cls, word: str, **attributes: object) -> Self:
        """Add a word with its attributes, or raise `ValueError` if the set has it already."""
        if word in cls._words:
            raise ValueError(f"{cls.__name__} has {word!r} already")
        added = cls._words[word] = str.__new__(cls, word)
        vars(added).update(attributes)
        return added

    @classmethod
    def all(cls) -> tuple[Self, ...]:
        """Return the words in the order of their registration."""
        return tuple(cls._words.values())

    @classmethod
    def of(cls, word: str) -> Self:
        """Return the registered word, or raise `LookupError`."""
        found: Self | None = cls._words.get(word)
        if found is None:
            near = difflib.get_close_matches(word, cls._words, n=1)
            raise LookupError(f"{cls.__name__} has no {word!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
        return found

    def __copy__(self) -> Self:
        """Return the word itself: words are compared by identity."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: object) -> CoreSchema:
        """Accept the words of the set, whichever are registered by then."""
        named = f"{cls.__module__}.{cls.__qualname__}"
        return core_schema.no_info_after_validator_function(cls._checked, core_schema.str_schema(), ref=named)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """List the words as an enumeration."""
        return {"type": "string", "title": cls.__name__, "description": cls.__doc__, "enum": [*map(str, cls.all())]}

    @classmethod
    def _checked(cls, word: str) -> Self:
        try:
            return cls.of(word)
        except LookupError:
            *most, last = (repr(str(each)) for each in cls.all())
            expected = f"{', '.join(most)} or {last}" if most else last
            raise PydanticCustomError("enum", "Input should be {expected}", {"expected": expected}) from None


class JobKind(RegisteredWord):
    """Kind of a job, for which a worker has code."""

    plural: str

    @classmethod
    def register(cls, name: str, plural: str) -> Self:
        """Add a kind of job; its name and the plural of what its jobs work on are part of addresses and folders."""
        return cls._add(name, plural=plural)


class JobState(StrEnum):
    """State of a job: queued, running, then one of the three ends."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """True if nothing more will happen."""
        return self in {JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED}


# A tuple, as conditions on rows need it.
ENDED = tuple(state for state in JobState if state.ended)
UNFINISHED = tuple(state for state in JobState if not state.ended)


class Priority(StrEnum):
    """Priority of a job: a client waits for it, it is one of a batch such as a schedule's, or it is for idle times."""

    # One line for each priority: its name, and its rank in the queue, the lowest first.
    INTERACTIVE = "interactive", 0
    BATCH = "batch", 1
    BACKGROUND = "background", 2

    rank: int

    def __new__(cls, name: str, rank: int) -> Self:
        """Make a word that carries the rank."""
        priority = str.__new__(cls, name)
        priority._value_, priority.rank = name, rank
        return priority


class FailureKind(StrEnum):
    """Cause of a failure: the client's input (no retry), a temporary fault (retried), or the service (alert)."""

    INPUT = "input"
    PASSING = "passing"
    INTERNAL = "internal"


class Failure(Contract):
    """Reason why a job failed, in one sentence: which value, and what would be right."""

    kind: FailureKind = Field(
        description="Cause of the failure, and so whether the job is tried again.", examples=["input"]
    )
    code: str = Field(description="Stable code, for programs.", examples=["too-long"])
    detail: str = Field(
        description="One sentence: which value, and what would be right.",
        examples=["the job needs more than the 6 hours that it may take: give a smaller file"],
    )


class Job(Stamped):
    """A job in its present state."""

    kind: JobKind = Field(description="Kind of work.")
    state: JobState = Field(description="State of the job.", examples=["running"])
    subject_id: Identifier = Field(description="Id of the object that the job works on.")
    short: bool = Field(
        default=False,
        description="Whether the job takes seconds. Short jobs have a lane of their own, in which none waits for a "
        "long job.",
        examples=[True],
    )
    priority: Priority = Field(
        Priority.INTERACTIVE,
        description="Jobs with `interactive` go first, those of a batch next.",
        examples=["interactive"],
    )
    queue_position: int | None = Field(
        None,
        description="Number of jobs before this one in the queue; for a short job, in its lane. Null once the job "
        "runs.",
        examples=[0],
    )
    seconds_left: float | None = Field(
        None,
        ge=0,
        description="Approximate number of seconds until the job succeeds: from its progress, and from recent times "
        "of jobs of its kind, with the jobs before it. Null: nothing is known, or the job has ended.",
        examples=[12.0],
    )
    background: Annotated[
        bool,
        Field(
            description="Whether the job is one of the examples: it starts when no other job could, and gives way to "
            "any other job."
        ),
    ] = Field(default=False, examples=[False])
    not_before: Time | None = Field(
        None,
        description="Earliest time of the next attempt. Null: the job is not waiting to be tried again.",
        examples=["2026-03-02T05:31:10Z"],
    )
    waiting_for: Failure | None = Field(
        None,
        description="Temporary failure because of which the job waits to be tried again. Null: the job is not waiting "
        "to be tried again.",
    )
    progress: Progress | None = Field(None, description="Progress. Null: the job does not run.")
    attempt: int = Field(
        description="Number of starts; the number tells one attempt from another, and is not limited.", examples=[1]
    )
    losses: int = Field(
        0,
        description="Number of attempts that were lost, as by a worker that was killed; the third loss fails the "
        "job. A clean stop of a worker, a full disk and a database that is away are no loss.",
    )
    worker: str | None = Field(
        None, description="Host and process of the worker that runs the job. Null: none does.", examples=["host:71"]
    )
    cancel_requested: bool = Field(
        default=False, description="Whether somebody has cancelled the job; a running job ends within seconds."
    )
    request_id: str | None = Field(
        None,
        description="The `X-Request-Id` of the request that queued the job; null: a schedule or another part of the "
        "service did.",
        examples=["0f8b4c6d0d8a4b0e9d0c5b8f3f1e2a77"],
    )
    key_id: str | None = Field(
        None, description="Id of the key that the request carried; null: none.", examples=["0f8b4c6d0d8a4b0e"]
    )
    asked_by: str | None = Field(
        None,
        description="Name of the key with which the job was requested, or who else requested it; null: a job of an "
        "earlier version.",
        examples=["software of line 2"],
    )
    started_at: datetime | None = Field(
        None,
        description="Start of the last attempt, RFC 3339, UTC. Null: the job has not started.",
        examples=["2026-03-02T05:31:00Z"],
    )
    finished_at: datetime | None = Field(
        None,
        description="End of the job, RFC 3339, UTC. Null: the job has not ended.",
        examples=["2026-03-02T05:31:04Z"],
    )
    failure: Failure | None = Field(None, description="Reason of the failure. Null: the job has not failed.")
