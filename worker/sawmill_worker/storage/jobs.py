"""The job store: claims, leases, ends (docs/architecture.md#jobs).

A claim is one conditional UPDATE. The attempt number fences: whatever an attempt reports counts only while
the row is still running that attempt. Losses are counted apart from it, for a worker that stops cleanly loses nothing.
"""

import random
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, exists, func, or_, select, update
from sqlalchemy.orm import Session, aliased

from sawmill_worker.contracts.base import Page
from sawmill_worker.contracts.jobs import Failure, FailureKind, Job, JobKind, JobState
from sawmill_worker.storage.database import Database, database_now_s
from sawmill_worker.storage.errors import Conflict, LeaseLost, StorageFull, StorageUnavailable
from sawmill_worker.storage.files import FileStore
from sawmill_worker.storage.paging import found, narrowed, read_page
from sawmill_worker.storage.subjects import checked_result, record_end_without_result, record_success
from sawmill_worker.storage.tables import JobDependencyRow, JobRow
from sawmill_worker.vocabulary import Progress

LONGEST_WAIT_S = 60.0
_JITTER = 0.25  # what failed together is not tried again together
# Not the job's fault nor its attempt's: waited out as long as they last. `disk-full`: a job's own check beforehand.
_OUTAGES = {StorageFull.code, StorageUnavailable.code, "disk-full"}
_ENDED = [state for state in JobState if state.ended]
_CANCELLED = "its job was cancelled before it ended"


@dataclass(frozen=True)
class Retries:
    """When a job is tried again after a passing failure. Waits double from one to the next, up to a minute.

    Attributes
    ----------
    max_losses : int
        The loss that fails the job.
    loss_wait_s : float
        First wait after a loss, such as a process that was killed.
    outage_wait_s : float
        First wait after a full disk or a database that was away, which are no loss.
    """

    max_losses: int = 3
    loss_wait_s: float = 1.0
    outage_wait_s: float = 5.0


RETRIES = Retries()
# Background jobs last; false sorts before true on SQLite and PostgreSQL.
_ORDER = (JobRow.background, JobRow.created_at, JobRow.id)


@dataclass(frozen=True)
class Claim:
    """The right to run one attempt at a job, for as long as heartbeats keep its lease."""

    job: Job

    @property
    def job_id(self) -> str:
        """The job's id."""
        return self.job.id

    @property
    def attempt(self) -> int:
        """The number that fences this attempt off from earlier and later ones."""
        return self.job.attempt


class Jobs:
    """Every method is one transaction."""

    def __init__(self, database: Database, files: FileStore) -> None:
        self._database = database
        self._files = files

    def get(self, job_id: str) -> Job:
        """One job, or `NotFound`."""
        with self._database.read() as session:
            return _read(session, found(session, JobRow, "job", job_id))

    def page(
        self,
        *,
        state: JobState | None = None,
        kind: JobKind | None = None,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[Job]:
        """Jobs, newest first."""
        statement = narrowed(select(JobRow), {JobRow.state: state, JobRow.kind: kind})
        with self._database.read() as session:
            return read_page(session, statement, JobRow, lambda row: _read(session, row), after=after, limit=limit)

    def counts(self) -> dict[JobState, int]:
        """How many jobs are in each state, none included."""
        with self._database.read() as session:
            counted = session.execute(select(JobRow.state, func.count().label("number")).group_by(JobRow.state))
            return dict.fromkeys(JobState, 0) | {row.state: row.number for row in counted}

    def request_cancel(self, job_id: str) -> Job:
        """Cancel a queued job at once; ask the worker of a running one to stop.

        Raises
        ------
        NotFound, Conflict
            There is no such job, or it has ended.
        """
        with self._database.write() as session:
            row = found(session, JobRow, "job", job_id, lock=True)
            if row.state.ended:
                raise Conflict("job-ended", f"job {job_id!r} has {row.state} already and cannot be cancelled")
            row.cancel_requested = True
            if row.state is JobState.QUEUED:
                self._end(session, row, JobState.CANCELLED, reason=_CANCELLED)
            session.flush()
            return _read(session, row)

    def claim(self, worker: str, *, lease_s: float) -> Claim | None:
        """Take the job whose turn it is: the oldest that could start, a background job only when there is no other.

        Parameters
        ----------
        worker
            Who takes it, for people to read.
        lease_s
            How long the claim holds without a heartbeat.

        Returns
        -------
        Claim or None
            None when there is nothing to do. Of many callers at once, one gets a job.
        """
        ready = _claimable().with_only_columns(JobRow.id).order_by(*_ORDER).limit(1)
        with self._database.write() as session:
            claimed = session.scalar(
                update(JobRow)
                .where(JobRow.id == ready.with_for_update(skip_locked=True).scalar_subquery())
                .where(JobRow.state == JobState.QUEUED)
                .values(
                    state=JobState.RUNNING,
                    attempt=JobRow.attempt + 1,
                    worker=worker,
                    lease_expires_s=database_now_s() + lease_s,
                    not_before_s=None,
                    waiting_for=None,
                    started_at=self._database.now(),
                    progress=None,
                )
                .returning(JobRow.id)
                .execution_options(synchronize_session=False)
            )
            return Claim(_read(session, found(session, JobRow, "job", claimed))) if claimed is not None else None

    def heartbeat(self, claim: Claim, progress: Progress | None = None, *, lease_s: float) -> bool:
        """Renew the lease and carry progress out.

        Returns
        -------
        bool
            Whether somebody asked for the job to be cancelled.

        Raises
        ------
        LeaseLost
            The attempt no longer holds the job.
        """
        values: dict[str, Any] = {"lease_expires_s": database_now_s() + lease_s}
        if progress is not None:
            values["progress"] = asdict(progress)
        with self._database.write() as session:
            cancel = session.scalar(
                update(JobRow)
                .where(_held_by(claim))
                .values(values)
                .returning(JobRow.cancel_requested)
                .execution_options(synchronize_session=False)
            )
        if cancel is None:
            raise LeaseLost(claim.job_id, claim.attempt)
        return cancel

    def succeed(self, claim: Claim, result: dict[str, Any], output: Path) -> None:
        """Publish an attempt's files and result, both or neither.

        Parameters
        ----------
        claim
            The attempt's.
        result
            What jobs of its kind answer with; stored with the job's subject.
        output
            The attempt's folder, flushed (`flush_tree`) by whoever wrote it; renamed to its subject's.

        Raises
        ------
        LeaseLost
            The attempt no longer holds the job: nothing was published.
        pydantic.ValidationError
            The result is not what jobs of this kind answer with.
        """
        kind, subject_id = claim.job.kind, claim.job.subject_id
        checked = checked_result(kind, result)
        with self._database.write() as session:
            row = _held(session, claim)
            self._end(session, row, JobState.SUCCEEDED)
            record_success(session, kind, subject_id, checked, self._database.now())
            session.flush()
            # Renamed while the row is locked: a late attempt cannot replace a newer one's files.
            self._files.publish(output, self._files.results(kind, subject_id))

    def fail(self, claim: Claim, failure: Failure, *, retries: Retries = RETRIES) -> JobState:
        """End an attempt that failed: after a passing failure the job waits in the queue, up to its last loss.

        Returns
        -------
        JobState
            `queued`, `failed`, or `cancelled` where that was asked for meanwhile.

        Raises
        ------
        LeaseLost
            The attempt no longer holds the job.
        """
        with self._database.write() as session:
            row = _held(session, claim)
            self._fail(session, row, failure, retries)
            return row.state

    def cancelled(self, claim: Claim) -> None:
        """End a running job as asked by `request_cancel`, or raise `LeaseLost`."""
        with self._database.write() as session:
            self._end(session, _held(session, claim), JobState.CANCELLED, reason=_CANCELLED)

    def release(self, claim: Claim) -> JobState:
        """Give a running job back to the queue because its worker stops or others go first, or raise `LeaseLost`.

        Returns
        -------
        JobState
            `queued`, or `cancelled` where that was asked for meanwhile.
        """
        with self._database.write() as session:
            row = _held(session, claim)
            if row.cancel_requested:
                self._end(session, row, JobState.CANCELLED, reason=_CANCELLED)
            else:
                _requeue(row)
            return row.state

    def requeue_expired(self, *, retries: Retries = RETRIES) -> Sequence[Job]:
        """See to running jobs whose lease ran out.

        Returns
        -------
        list of Job
            As they stand now: queued again, failed at the last loss (`worker-lost`), or cancelled if asked.
        """
        expired = (
            select(JobRow)
            .where(JobRow.state == JobState.RUNNING, JobRow.lease_expires_s < database_now_s())
            .with_for_update(skip_locked=True)
        )
        with self._database.read() as session:
            if session.scalar(expired.with_only_columns(JobRow.id).limit(1)) is None:
                return []
        with self._database.write() as session:
            rows = session.scalars(expired).all()
            for row in rows:
                self._fail(session, row, _worker_lost(row), retries)
            session.flush()
            jobs = [_read(session, row) for row in rows]
        for job in jobs:
            if job.state.ended:
                self._files.remove_attempts(job.id)
        return jobs

    def queued_job_ids(self, *, older_than_s: float = 0.0) -> Sequence[str]:
        """Jobs that could have started that long ago, first come first: their wake-up may be lost."""
        limit = self._database.now() - timedelta(seconds=older_than_s)
        due = or_(JobRow.not_before_s.is_(None), JobRow.not_before_s <= database_now_s() - older_than_s)
        statement = _claimable().with_only_columns(JobRow.id).where(JobRow.created_at <= limit, due)
        with self._database.read() as session:
            return session.scalars(statement.order_by(*_ORDER)).all()

    def is_in_the_way(self, claim: Claim) -> bool:
        """Whether an attempt's job is for idle times, as its row stands now, and one could start that is not."""
        other = _claimable().with_only_columns(JobRow.id).where(~JobRow.background).limit(1)
        itself = select(JobRow.id).where(_held_by(claim), JobRow.background)
        with self._database.read() as session:
            return session.scalar(other) is not None and session.scalar(itself) is not None

    def waiting_for(self, job_id: str) -> Sequence[str]:
        """Queued jobs that needed this one and could start now."""
        needs_it = JobRow.id.in_(select(JobDependencyRow.job_id).where(JobDependencyRow.needs_job_id == job_id))
        with self._database.read() as session:
            return session.scalars(_claimable().with_only_columns(JobRow.id).where(needs_it)).all()

    def _fail(self, session: Session, row: JobRow, failure: Failure, retries: Retries) -> None:
        if failure.kind is FailureKind.PASSING:
            if row.cancel_requested:
                self._end(session, row, JobState.CANCELLED, reason=_CANCELLED)
                return
            if failure.code in _OUTAGES:
                row.outages += 1
                _wait(row, failure, retries.outage_wait_s, row.outages)
                return
            row.losses, row.outages = row.losses + 1, 0
            if row.losses < retries.max_losses:
                _wait(row, failure, retries.loss_wait_s, row.losses)
                return
        row.failure = failure.model_dump(mode="json")
        self._end(session, row, JobState.FAILED, reason=failure.detail)

    def _end(self, session: Session, row: JobRow, state: JobState, *, reason: str | None = None) -> None:
        row.state = state
        row.finished_at = self._database.now()
        row.lease_expires_s = row.not_before_s = row.waiting_for = None
        if reason is not None:
            record_end_without_result(session, row.kind, row.subject_id, reason)


def _claimable() -> Select[JobRow]:
    needed = aliased(JobRow)
    unfinished = exists().where(
        JobDependencyRow.job_id == JobRow.id,
        needed.id == JobDependencyRow.needs_job_id,
        needed.state.not_in(_ENDED),
    )
    due = or_(JobRow.not_before_s.is_(None), JobRow.not_before_s <= database_now_s())
    return select(JobRow).where(JobRow.state == JobState.QUEUED, due, ~unfinished)


def _held_by(claim: Claim) -> ColumnElement[bool]:
    return and_(JobRow.id == claim.job_id, JobRow.state == JobState.RUNNING, JobRow.attempt == claim.attempt)


def _held(session: Session, claim: Claim) -> JobRow:
    row = session.scalar(select(JobRow).where(_held_by(claim)).with_for_update())
    if row is None:
        raise LeaseLost(claim.job_id, claim.attempt)
    return row


def _requeue(row: JobRow) -> None:
    row.state = JobState.QUEUED
    row.worker = row.lease_expires_s = row.started_at = row.progress = None


def _wait(row: JobRow, failure: Failure, first_wait_s: float, time: int) -> None:
    """Put a job back into the queue until its wait is over: the first one, the second one, and so on."""
    _requeue(row)
    wait_s = min(first_wait_s * 2.0 ** min(time - 1, 30), LONGEST_WAIT_S)
    row.not_before_s = database_now_s() + wait_s * random.uniform(1.0 - _JITTER, 1.0 + _JITTER)  # noqa: S311
    row.waiting_for = failure.model_dump(mode="json")


def _worker_lost(row: JobRow) -> Failure:
    return Failure(
        kind=FailureKind.PASSING,
        code="worker-lost",
        detail=f"attempt {row.attempt} ended unanswered: its worker {row.worker!r} stopped or lost its connection",
    )


def _queue_position(session: Session, row: JobRow) -> int | None:
    if row.state is not JobState.QUEUED:
        return None
    older = or_(JobRow.created_at < row.created_at, and_(JobRow.created_at == row.created_at, JobRow.id < row.id))
    before = or_(~JobRow.background, older) if row.background else and_(~JobRow.background, older)
    return session.scalar(select(func.count()).where(JobRow.state == JobState.QUEUED, before))


def _read(session: Session, row: JobRow) -> Job:
    return Job.model_validate(
        {
            "id": row.id,
            "created_at": row.created_at,
            "kind": row.kind,
            "state": row.state,
            "subject_id": row.subject_id,
            "queue_position": _queue_position(session, row),
            "background": row.background,
            "not_before": None if row.not_before_s is None else datetime.fromtimestamp(row.not_before_s, UTC),
            "waiting_for": row.waiting_for,
            "progress": row.progress,
            "attempt": row.attempt,
            "losses": row.losses,
            "worker": row.worker,
            "cancel_requested": row.cancel_requested,
            "started_at": row.started_at,
            "finished_at": row.finished_at,
            "failure": row.failure,
        }
    )
