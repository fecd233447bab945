"""The job store's interface to the package that owns the kinds of jobs."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from sqlalchemy.orm import Session

from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.tables import JobRow
from sawmill_platform.files.named_folders import NamedFolder


class Recorded(NamedTuple):
    """A result for the ledger: a sentence for the history, and details for the event, which go to all followers."""

    why: str | None = None
    detail: Mapping[str, Any] = {}


class Subjects(Protocol):
    """Rows and files that jobs work on; methods with a session are called within the job store's transaction."""

    named_folders: Sequence[NamedFolder]
    """Folders in which these rows name files."""

    def handed_over(self, session: Session, job: JobRow) -> AttemptInput:
        """Return the input of an attempt at a job.

        Raises
        ------
        NotFound
            A resource that the job refers to was deleted since the job was queued.
        """

    def record_success(
        self, session: Session, kind: JobKind, subject_id: str, result: Contract, now: datetime
    ) -> Recorded:
        """Write a result to the job's subject."""

    def record_end_without_result(
        self, session: Session, kind: JobKind, subject_id: str, reason: str, now: datetime
    ) -> None:
        """Write to the job's subject that its job failed or was cancelled."""

    def output_file(self, kind: JobKind, folder: Path) -> Path | None:
        """Return the file that a job left, unopened; None: it left none.

        Raises
        ------
        InvalidOutput
            The folder has other files than a job of the kind leaves; one sentence states what is wrong.
        """

    def read_apart(self, path: Path) -> None:
        """Read a result of an earlier version, which has no digest, in a separate process.

        Raises
        ------
        DamagedResult
            The file cannot be read to its end.
        """
