"""Input of the process of an attempt, and the interface to the package that owns the kinds of jobs."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.contracts.jobs import Job
from sawmill_platform.files.file_store import checkpoints_of
from sawmill_vocabulary import Progress, ProgressCallback

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
