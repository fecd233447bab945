"""The messages between a supervisor and the process of an attempt, one JSON object a line.

Down, on the process's standard input: one `Assignment`; then nothing; its end means that the supervisor is gone.
Up, on the inherited pipe that the environment variable `CHANNEL` names: `Ready`, then, after the assignment, `Begun`,
any number of `ProgressMade` and `Kept`, and one `Succeeded` or `Failed`. No line is longer than `LONGEST_LINE_BYTES`,
and none but that of `Succeeded` longer than `LONGEST_SENTENCE_BYTES`.
Standard output stays free for whoever prints.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import Failure, Job
from sawmill_vocabulary import Progress

CHANNEL = "SAWMILL_ATTEMPT_CHANNEL"
# A hundred times the longest answer of the science.
LONGEST_LINE_BYTES = 16 * 2**20
# Of whatever is no answer of the science: sixty times the longest sentence of a refusal.
LONGEST_SENTENCE_BYTES = 2**16


class Assignment(Contract):
    """Run this attempt; `given_json` is an `AttemptInput` with the fields of the package that owns the job's kind."""

    job: Job
    given_json: str
    output: Path


class Ready(Contract):
    """Everything is imported: the process waits for its assignment."""

    kind: Literal["ready"] = "ready"


class Begun(Contract):
    """The process keeps to its limits and its own files, and begins with the job.

    The limits are those of `limits.Limits`: they are sent before anything that a stranger wrote is read.
    """

    kind: Literal["begun"] = "begun"
    data_bytes: int
    file_bytes: int


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


AnyMessage = Ready | Begun | ProgressMade | Kept | Succeeded | Failed
MESSAGE: TypeAdapter[AnyMessage] = TypeAdapter(Annotated[AnyMessage, Field(discriminator="kind")])


def to_line(message: Contract) -> bytes:
    """One line of the protocol."""
    return message.model_dump_json().encode() + b"\n"
