"""Writing a job's row, inside the transaction that accepts its subject."""

from collections.abc import Iterable
from datetime import datetime

from sqlalchemy.orm import Session

from worker.contracts.jobs import JobKind, JobState
from worker.storage.paging import new_id, refuse_taken
from worker.storage.tables import JobDependencyRow, JobRow


def queue_job(
    session: Session,
    kind: JobKind,
    subject_id: str,
    now: datetime,
    *,
    needs: Iterable[str] = (),
    job_id: str | None = None,
) -> str:
    """Queue a job that starts only when the jobs it needs have ended, and return its id."""
    job_id = job_id or new_id()
    refuse_taken(session, JobRow, "job", job_id)
    session.add(
        JobRow(
            id=job_id,
            created_at=now,
            kind=kind,
            state=JobState.QUEUED,
            subject_id=subject_id,
            attempt=0,
            cancel_requested=False,
        )
    )
    session.flush()
    session.add_all(JobDependencyRow(job_id=job_id, needs_job_id=needed) for needed in needs)
    return job_id
