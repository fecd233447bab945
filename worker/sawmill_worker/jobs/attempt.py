"""The argument of a job's functions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.jobs import Job
from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.contracts.base import Contract
from sawmill_store.files import checkpoints_of
from sawmill_vocabulary import Progress, ProgressCallback

Asked = TypeVar("Asked", bound=Contract)


@dataclass(frozen=True)
class Attempt:
    """An attempt at a job.

    Attributes
    ----------
    job : Job
        The job as it was claimed.
    given : HandedOver
        The rows and files of the job's input; results go through `output` and the return value.
    output : Path
        An empty folder; files written there become files of the job's subject.
    report : callable
        Function that takes the job's progress.
    announce : callable
        Function that takes the names of complete checkpoints in `checkpoints`; these checkpoints are kept with the job.
    """

    job: Job
    given: HandedOver
    output: Path
    report: ProgressCallback
    announce: Callable[[Sequence[str]], None]

    @property
    def checkpoints(self) -> Path:
        """Folder for checkpoints, which are not results."""
        return checkpoints_of(self.output)

    @property
    def file(self) -> Path:
        """File that the job reads."""
        assert self.given.file is not None  # noqa: S101 - required by kinds that read a file
        return self.given.file

    @property
    def scanner(self) -> StoredScanner:
        """Scanner of the scan or of the request."""
        assert self.given.scanner is not None  # noqa: S101 - required by kinds with a scanner
        return self.given.scanner

    def asked(self, contract: type[Asked]) -> Asked:
        """Return the job's own row as the contract of unfinished jobs of this kind."""
        assert self.given.asked_json is not None  # noqa: S101 - required by kinds that are requested
        return contract.model_validate_json(self.given.asked_json)

    def report_stage(self, fraction: float, stage: str) -> None:
        """Report progress."""
        self.report(Progress(fraction=fraction, stage=stage))
