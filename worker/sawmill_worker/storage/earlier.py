"""Answering a job from an earlier result of the same origin, with files that are its own: second names of the bytes."""

from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_worker.contracts.events import EventKind
from sawmill_worker.contracts.jobs import JobKind, JobState
from sawmill_worker.contracts.kinds import AskedKind, declaration_of
from sawmill_worker.storage.database import lock_files_of
from sawmill_worker.storage.events import record
from sawmill_worker.storage.files import FileStore
from sawmill_worker.storage.handing_over import handed_over
from sawmill_worker.storage.origins import origin_of
from sawmill_worker.storage.software import software
from sawmill_worker.storage.subjects import record_success
from sawmill_worker.storage.tables import JobRow, Json, table_of

# Of which the files may have been removed by hand.
_MOST_LOOKED_AT = 10


class Earlier(NamedTuple):
    """A result that is there already.

    Attributes
    ----------
    computed_id : str
        Id of the subject for which it was computed.
    kept_with : str
        Id of the subject whose files are there: the same, or one that was answered from it.
    result : dict
        As it is stored.
    """

    computed_id: str
    kept_with: str
    result: Json


def earlier_result(session: Session, files: FileStore, kind: JobKind, origin: str) -> Earlier | None:
    """The newest result of an origin whose files are there; None for a kind that nobody asks for."""
    declared = declaration_of(kind)
    if not isinstance(declared, AskedKind):
        return None
    table = table_of(kind)
    same = select(table).join(table.job).where(JobRow.origin == origin, JobRow.state == JobState.SUCCEEDED)
    for row in session.scalars(same.order_by(JobRow.created_at.desc()).limit(_MOST_LOOKED_AT)):
        folder = files.results(kind, row.id)
        # What was refused may have been for lack of memory at that time.
        if row.result is None or row.result.get("refusal") is not None:
            continue
        if all(_has_content(folder / name) for name in declared.leaves):
            return Earlier(row.job.answered_from or row.id, row.id, row.result)
    return None


def answer_at_once(session: Session, files: FileStore, job: JobRow, now: datetime) -> None:
    """End a job that was queued in this transaction with an earlier result, if there is one.

    Where its files cannot have second names, the job stays queued.
    """
    origin = origin_of(job.kind, handed_over(session, files, job), software())
    earlier = None if origin is None else earlier_result(session, files, job.kind, origin)
    if earlier is None:
        return
    output = files.make_attempt_folder(job.id, job.attempt)
    try:
        if files.take_over(job.kind, earlier.kept_with, output):
            job.state, job.finished_at = JobState.SUCCEEDED, now
            job.origin, job.answered_from = origin, earlier.computed_id
            record(session, now, EventKind.SUCCEEDED, job, {"answered_from": earlier.computed_id})
            record_success(session, job.kind, job.subject_id, earlier.result, now)
            session.flush()
            # As in `Jobs.succeed`: without a commit the files go with the `leftovers`.
            lock_files_of(session, job.subject_id)
            files.publish(output, files.results(job.kind, job.subject_id))
    finally:
        files.remove(output)


def _has_content(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0
