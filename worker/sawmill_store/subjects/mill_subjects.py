"""Subjects of a mill's jobs for the job store: scans, phantoms and the requests that refer to them."""

from datetime import datetime
from pathlib import Path
from typing import cast

from sqlalchemy.orm import Session

from sawmill_contracts.handed_over import HandedOver
from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.tables import JobRow
from sawmill_platform.files.file_store import FileStore
from sawmill_store.subjects import effects, outputs
from sawmill_store.subjects.handing_over import handed_over


class MillSubjects:
    """Rows of a mill that jobs work on, as `sawmill_platform.jobs.subjects.Subjects` describes them."""

    def __init__(self, files: FileStore) -> None:
        self._files = files

    def handed_over(self, session: Session, job: JobRow) -> HandedOver:
        """Return the rows that a job's own row refers to, and the file that it reads."""
        return handed_over(session, self._files, job)

    def record_success(
        self, session: Session, kind: JobKind, subject_id: str, result: Contract, now: datetime
    ) -> str | None:
        """Write a result to the job's subject; return a sentence about the result for the history, if any."""
        return effects.record_success(session, kind, subject_id, result, now)

    def record_end_without_result(
        self, session: Session, kind: JobKind, subject_id: str, reason: str, now: datetime
    ) -> None:
        """Refuse the scan or the phantom whose job failed or was cancelled."""
        effects.record_end_without_result(session, kind, subject_id, reason, now)

    def check_output(self, kind: JobKind, given: AttemptInput, result: Contract, folder: Path) -> None:
        """Refuse a folder with files that a job of this kind does not write."""
        outputs.check_output(kind, cast("HandedOver", given), result, folder)
