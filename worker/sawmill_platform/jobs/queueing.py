"""Writing a job's row, inside the transaction that accepts its subject."""

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from sawmill_platform.acting import actor
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobKind, JobState, Priority
from sawmill_platform.database.paging import new_id, refuse_taken
from sawmill_platform.database.tables import JobDependencyRow, JobRow
from sawmill_platform.ledger.events import record


def queue_job(
    session: Session,
    kind: JobKind,
    subject_id: str,
    now: datetime,
    *,
    short: bool,
    group_id: str | None,
    needs: Sequence[str] = (),
    job_id: str | None = None,
    priority: Priority = Priority.WAITED_FOR,
) -> JobRow:
    """Queue a job that starts only when the jobs that it needs have ended.

    Needed jobs that are behind it in the queue are brought forward.
    """
    job_id = job_id or new_id()
    refuse_taken(session, JobRow, "job", job_id)
    asked_by = actor()
    row = JobRow(
        id=job_id,
        created_at=now,
        kind=kind,
        state=JobState.QUEUED,
        subject_id=subject_id,
        priority=priority,
        short=short,
        group_id=group_id or "",
        attempt=0,
        beats=0,
        losses=0,
        outages=0,
        cancel_requested=False,
        request_id=asked_by.request_id,
        key_id=asked_by.key_id,
        asked_by=asked_by.name,
    )
    session.add(row)
    record(session, row.created_at, event_kinds.QUEUED, row)
    session.flush()
    session.add_all(JobDependencyRow(job_id=job_id, needs_job_id=needed) for needed in needs)
    _bring_forward(session, needs, priority)
    return row


def _bring_forward(session: Session, job_ids: Sequence[str], priority: Priority) -> None:
    while job_ids:
        behind = update(JobRow).where(JobRow.id.in_(job_ids), JobRow.priority > priority)
        session.execute(behind.values(priority=priority))
        needed = select(JobDependencyRow.needs_job_id).where(JobDependencyRow.job_id.in_(job_ids))
        job_ids = session.scalars(needed).all()
