"""What a job's functions are given."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import Job
from sawmill_platform.files.file_store import checkpoints_of
from sawmill_vocabulary import Progress, ProgressCallback

Asked = TypeVar("Asked", bound=Contract)


@dataclass(frozen=True)
class Attempt:
    """One attempt at a job.

    Attributes
    ----------
    job : Job
        As it was claimed.
    given : HandedOver
        What it works on; results go through `output` and the return value.
    output : Path
        An empty folder: the files in it become the subject's.
    report : callable
        Takes the job's progress.
    announce : callable
        Takes the names of checkpoints in `checkpoints` that are complete: they are kept with the job.
    """

    job: Job
    given: HandedOver
    output: Path
    report: ProgressCallback
    announce: Callable[[Sequence[str]], None]

    @property
    def checkpoints(self) -> Path:
        """The folder for checkpoints, which are no results."""
        return checkpoints_of(self.output)

    @property
    def file(self) -> Path:
        """What the job reads."""
        assert self.given.file is not None  # noqa: S101 - of a kind that reads one
        return self.given.file

    @property
    def scanner(self) -> StoredScanner:
        """Of the scan, or of the ask."""
        assert self.given.scanner is not None  # noqa: S101 - of a kind that has one
        return self.given.scanner

    def asked(self, contract: type[Asked]) -> Asked:
        """The job's own row, of the contract that its kind answers with while it is unfinished."""
        assert self.given.asked_json is not None  # noqa: S101 - of a kind that is asked for
        return contract.model_validate_json(self.given.asked_json)

    def report_stage(self, fraction: float, stage: str) -> None:
        """Report progress."""
        self.report(Progress(fraction=fraction, stage=stage))
