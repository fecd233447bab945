"""Input of an attempt at a job, its failure, and its folder for checkpoints."""

from pathlib import Path

from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import FailureKind


class AttemptInput(Contract):
    """Input that a worker passes to the process of an attempt; packages that own kinds of jobs add fields."""

    file: Path | None = None  # the file that the job reads, as an upload; null: the job reads none, or several
    files: tuple[Path, ...] = ()  # the uploads of a job that reads several
    kept: Path  # the folder with checkpoints of earlier attempts; it may be missing

    @property
    def readable(self) -> tuple[Path, ...]:
        """All files that the job may read."""
        return self.files if self.file is None else (self.file, *self.files)


class JobFailure(Exception):  # noqa: N818 - the contract's word
    """A job that ends without a result; its code is stable, its detail says which value, and what would be right."""

    def __init__(self, kind: FailureKind, code: str, detail: str) -> None:
        super().__init__(detail)
        self.kind, self.code, self.detail = kind, code, detail


def checkpoints_of(output: Path) -> Path:
    """Return the folder, within an attempt's own, for checkpoints, which are no results."""
    return output / "kept"
