"""What a job's functions are given."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sawmill_worker.contracts.jobs import Job
from sawmill_worker.storage.store import Store
from sawmill_worker.vocabulary import Progress, ProgressCallback


@dataclass(frozen=True)
class Attempt:
    """One attempt at a job.

    Attributes
    ----------
    job : Job
        As it was claimed.
    store : Store
        To load from; results go through `output` and the return value.
    output : Path
        An empty folder: the files in it become the subject's.
    report : callable
        Takes the job's progress.
    announce : callable
        Takes the names of checkpoints in `checkpoints` that are complete: they are kept with the job.
    """

    job: Job
    store: Store
    output: Path
    report: ProgressCallback
    announce: Callable[[Sequence[str]], None]

    @property
    def checkpoints(self) -> Path:
        """The folder for checkpoints, which are no results."""
        return self.store.files.checkpoints(self.output)

    def report_stage(self, fraction: float, stage: str) -> None:
        """Report progress."""
        self.report(Progress(fraction=fraction, stage=stage))
