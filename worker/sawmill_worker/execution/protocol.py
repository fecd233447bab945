"""The messages between a supervisor and the process of an attempt, one JSON object a line.

Down, on the process's standard input: one `Assignment`; then nothing; its end means that the supervisor is gone.
Up, on the inherited pipe that the environment variable `CHANNEL` names: `Ready`, then, after the assignment,
any number of `ProgressMade` and `Kept` and one `Succeeded` or `Failed`. Standard output stays free for whoever prints.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from sawmill_worker.contracts.base import Contract
from sawmill_worker.contracts.handed_over import HandedOver
from sawmill_worker.contracts.jobs import Failure, Job
from sawmill_worker.vocabulary import Progress

CHANNEL = "SAWMILL_ATTEMPT_CHANNEL"


class Assignment(Contract):
    """Run this attempt."""

    job: Job
    given: HandedOver
    output: Path


class Ready(Contract):
    """Everything is imported: the process waits for its assignment."""

    kind: Literal["ready"] = "ready"


class ProgressMade(Contract):
    """How far it is."""

    kind: Literal["progress"] = "progress"
    progress: Progress


class Kept(Contract):
    """Checkpoints of these names are complete in the output's folder for them: keep them with the job."""

    kind: Literal["kept"] = "kept"
    names: list[str]


class Succeeded(Contract):
    """The output folder is complete and flushed."""

    kind: Literal["succeeded"] = "succeeded"
    result: dict[str, Any]
    peak_memory_bytes: int | None = None


class Failed(Contract):
    """It could not be done."""

    kind: Literal["failed"] = "failed"
    failure: Failure
    peak_memory_bytes: int | None = None


Message = Annotated[Ready | ProgressMade | Kept | Succeeded | Failed, Field(discriminator="kind")]
MESSAGE: TypeAdapter[Ready | ProgressMade | Kept | Succeeded | Failed] = TypeAdapter(Message)


def to_line(message: Contract) -> bytes:
    """One line of the protocol."""
    return message.model_dump_json().encode() + b"\n"
