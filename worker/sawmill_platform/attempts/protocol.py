"""The messages between a supervisor and the process of an attempt, one JSON object a line.

To the process, on its standard input: one `Assignment`, then nothing; the end of the stream means that the supervisor
is gone. From the process, on the inherited pipe that the environment variable `CHANNEL` names: `Ready`, then, after the
assignment, `Begun`, any number of `ProgressMade` and `Kept`, and one `Succeeded` or `Failed`. No line is longer than
`LONGEST_LINE_BYTES`, and no line except `Succeeded` longer than `LONGEST_SENTENCE_BYTES`. Standard output stays free
for libraries that print.

The package that owns the kinds of jobs implements `Work`.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, NamedTuple, Protocol, TypeVar

from pydantic import Field, TypeAdapter

from sawmill_platform.contracts.attempts import AttemptInput, checkpoints_of
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import Failure, Job
from sawmill_vocabulary import Progress, ProgressCallback

CHANNEL = "SAWMILL_ATTEMPT_CHANNEL"
# A hundred times the longest answer of a job.
LONGEST_LINE_BYTES = 16 * 2**20
# Length of every other message: sixty times the longest sentence of a refusal.
LONGEST_SENTENCE_BYTES = 2**16


class Assignment(Contract):
    """Order to run this attempt; `given_json` is an `AttemptInput` with the fields of the package of the job's kind.

    With an answer the order is to check a file that another attempt at the job wrote: it is the input's file, and must
    fit the answer.
    """

    job: Job
    given_json: str
    output: Path
    answer: dict[str, Any] | None = None


class Ready(Contract):
    """Report that everything is imported: the process waits for its assignment."""

    kind: Literal["ready"] = "ready"


class Begun(Contract):
    """Report that the process has set its limits, is confined to its own files, and starts the job.

    The limits are `limits.Limits`. The message is sent before the process reads anything that a stranger wrote.
    """

    kind: Literal["begun"] = "begun"
    data_bytes: int
    file_bytes: int


class ProgressMade(Contract):
    """Report of the job's progress."""

    kind: Literal["progress"] = "progress"
    progress: Progress


class Kept(Contract):
    """Report that checkpoints of these names are complete in the output's checkpoint folder: keep them with the job."""

    kind: Literal["kept"] = "kept"
    names: list[str]


class Succeeded(Contract):
    """Report that the output folder is complete and flushed."""

    kind: Literal["succeeded"] = "succeeded"
    result: dict[str, Any]
    peak_memory_bytes: int | None = None


class Failed(Contract):
    """Report that the job failed."""

    kind: Literal["failed"] = "failed"
    failure: Failure
    peak_memory_bytes: int | None = None


AnyMessage = Ready | Begun | ProgressMade | Kept | Succeeded | Failed
MESSAGE: TypeAdapter[AnyMessage] = TypeAdapter(Annotated[AnyMessage, Field(discriminator="kind")])


def to_line(message: Contract) -> bytes:
    """Return a message as one line of the protocol."""
    return message.model_dump_json().encode() + b"\n"


Given = TypeVar("Given", bound=AttemptInput)


@dataclass(frozen=True)
class Attempt(Generic[Given]):
    """Attempt at a job."""

    job: Job  # the job in the state in which it was claimed
    given: Given  # input; results go through `output` and the return value
    output: Path  # an empty folder: the files in it become the subject's
    report: ProgressCallback  # function that takes the job's progress
    # Function that takes the names of complete checkpoints in `checkpoints`, which are kept with the job.
    announce: Callable[[Sequence[str]], None]
    monotonic: Callable[[], float] = time.monotonic  # clock of the pauses between checkpoints, seconds

    @property
    def checkpoints(self) -> Path:
        """The folder for checkpoints, which are no results."""
        return checkpoints_of(self.output)

    @property
    def file(self) -> Path:
        """The file that the job reads."""
        assert self.given.file is not None  # noqa: S101 - of a kind that reads one
        return self.given.file

    def report_stage(self, fraction: float, stage: str) -> None:
        """Report progress."""
        self.report(Progress(fraction=fraction, stage=stage))


class Needs(NamedTuple):
    """Bytes of private memory, and of the largest file."""

    memory_bytes: int
    file_bytes: int


AnyAttempt = TypeVar("AnyAttempt", bound=Attempt[Any])


class Work(Protocol[AnyAttempt]):
    """Work of the kinds of jobs, with the methods that the process of an attempt needs."""

    def warm_up(self) -> None:
        """Load what every job needs, before the job is known."""

    def attempt(
        self,
        job: Job,
        given_json: str,
        output: Path,
        report: ProgressCallback,
        announce: Callable[[Sequence[str]], None],
    ) -> AnyAttempt:
        """Return the attempt, with its input read."""

    def needs_of(self, attempt: AnyAttempt) -> Needs:
        """Return what the job may need, or raise `JobFailure`."""

    def make_ready(self, attempt: AnyAttempt) -> None:
        """Compile what `run` needs: from then on the process may not write outside its own folder."""

    def check(self, attempt: AnyAttempt, answer: dict[str, Any]) -> None:
        """Check the file that an attempt wrote, which is this attempt's input; raise `InvalidOutput`."""

    def run(self, attempt: AnyAttempt) -> dict[str, Any]:
        """Do the job and return its answer as JSON, or raise `JobFailure`; any other exception is a defect."""
