"""The job store: claims, leases, ends (docs/understand/architecture.md#jobs).

A claim is one conditional UPDATE of the job that is next in turn (`turns`). The attempt number fences: reports of an
attempt count only while the row is still running that attempt. Losses are counted apart from the number, because a
worker that stops cleanly loses nothing.
"""

import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import structlog
from sqlalchemy import ColumnElement, Select, and_, exists, func, or_, select, update
from sqlalchemy.orm import Session, aliased

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.contracts.base import Contract, Page
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.jobs import ENDED, Failure, FailureKind, Job, JobKind, JobState, Priority
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.database.database import Database, after_commit, lock_files_of
from sawmill_platform.database.paging import found, narrowed, rows_of_page
from sawmill_platform.database.tables import DataFolderRow, EventRow, JobDependencyRow, JobRow, Json
from sawmill_platform.errors import Conflict, LeaseLost, StorageFull, StorageUnavailable
from sawmill_platform.files.file_store import FileStore, read_identity
from sawmill_platform.files.folder_identity import check_identity
from sawmill_platform.jobs.tallies import Subjects
from sawmill_platform.jobs.wait_estimate import (
    ANY,
    FIRST_COME,
    NOTHING_KNOWN,
    QUEUED,
    Selection,
    WaitEstimate,
    WaitEstimates,
    note_served,
    places,
    turns,
)
from sawmill_platform.ledger.events import PEAK_MEMORY, announce, record
from sawmill_platform.workers.settings import LONGEST_WAIT_S, Retries
from sawmill_vocabulary import Progress

_JITTER = 0.25  # jobs that failed together are not retried together
# Neither the job's fault nor its attempt's: the job waits as long as they last. `disk-full`: a job's own check.
_OUTAGES = {StorageFull.code, StorageUnavailable.code, "disk-full"}
_ENDED_HERE = "jobs ended in this session"
_CANCELLED = "its job was cancelled before it ended"


RETRIES = Retries()


class Pulse(NamedTuple):
    """Number of heartbeats of a running attempt, for comparison with the number that an observer saw before."""

    job_id: str
    attempt: int
    beats: int
    cancel_requested: bool


@dataclass(frozen=True)
class Claim:
    """The right to run one attempt at a job, for as long as observers see its heartbeats."""

    job: Job
    selection: Selection = ANY

    @property
    def job_id(self) -> str:
        """Id of the job."""
        return self.job.id

    @property
    def attempt(self) -> int:
        """Number that fences this attempt off from earlier and later ones."""
        return self.job.attempt


class Jobs:
    """Store of jobs; every method is one transaction."""

    def __init__(self, database: Database, files: FileStore, subjects: Subjects) -> None:
        self._database = database
        self._files = files
        self._subjects = subjects
        self._estimates = WaitEstimates()

    def get(self, job_id: str) -> Job:
        """Return one job, or raise `NotFound`."""
        with self._database.read() as session:
            return self._described(session, [found(session, JobRow, "job", job_id)])[0]

    def page(
        self,
        *,
        state: JobState | None = None,
        kind: JobKind | None = None,
        ended: bool = False,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[Job]:
        """Return a page of jobs, the newest request first; with `ended` those that have ended in any state."""
        jobs = select(JobRow).where(JobRow.state.in_(ENDED)) if ended else select(JobRow)
        statement = narrowed(jobs, {JobRow.state: state, JobRow.kind: kind})
        with self._database.read() as session:
            rows, following = rows_of_page(session, statement, JobRow, after=after, limit=limit)
            return Page[Job](items=self._described(session, rows), next=following)

    def waiting_in_line(self, *, kind: JobKind | None = None, limit: int = 50) -> list[Job]:
        """Return queued jobs, in the order of their turns."""
        with self._database.read() as session:
            first = [place.job_id for place in places(session) if kind in {None, place.kind}][:limit]
            rows = {row.id: row for row in session.scalars(select(JobRow).where(JobRow.id.in_(first)))}
            return self._described(session, [rows[job_id] for job_id in first])

    def counts(self) -> dict[JobState, int]:
        """Return the number of jobs in each state, zeros included."""
        with self._database.read() as session:
            counted = session.execute(select(JobRow.state, func.count().label("number")).group_by(JobRow.state))
            return dict.fromkeys(JobState, 0) | {row.state: row.number for row in counted}

    def request_cancel(self, job_id: str) -> Job:
        """Cancel a queued job at once; request the worker of a running job to stop; on a full disk too.

        Raises
        ------
        NotFound, Conflict
            There is no such job, or it has ended.
        """
        with self._ending() as session:
            self._database.spare_room.give_up_piece()
            row = found(session, JobRow, "job", job_id, lock=True)
            if row.state.ended:
                raise Conflict("job-ended", f"job {job_id!r} has {row.state} already and cannot be cancelled")
            if not row.cancel_requested:
                of = {"kind": row.kind, "subject_id": row.subject_id}
                now = self._database.now()
                announce(session, now, event_kinds.JOB_CANCELLED, "job", job_id, job_id=job_id, decided=of)
                if row.state is JobState.RUNNING:
                    announce(
                        session,
                        now,
                        event_kinds.CANCEL_REQUESTED,
                        declaration_of(row.kind).noun,
                        row.subject_id,
                        group_id=row.group_id or None,
                        job_id=row.id,
                    )
            row.cancel_requested = True
            if row.state is JobState.QUEUED:
                self._cancel(session, row)
            session.flush()
            return self._described(session, [row])[0]

    def claim(self, worker: str, selection: Selection = ANY) -> Claim | None:
        """Claim the next job: of the jobs that can start and have the highest priority, the oldest of the group.

        Among several groups, the group that was served longest ago is next.
        """
        identity = read_identity(self._files.folder)
        if identity is not None:
            self._files.check_writable()
        now = self._database.now()
        ready = _claimable(now, selection).order_by(JobRow.created_at, JobRow.id).limit(1)
        taken = (
            update(JobRow)
            .where(QUEUED, exists().where(DataFolderRow.identity == identity))
            .values(
                state=JobState.RUNNING,
                attempt=JobRow.attempt + 1,
                worker=worker,
                beats=0,
                not_before_s=None,
                waiting_for=None,
                started_at=now,
                progress=None,
            )
            .returning(JobRow.id)
            .execution_options(synchronize_session=False)
        )
        with self._database.write() as session:
            for turn in turns(session, selection):
                oldest = ready.where(*turn.conditions()).with_for_update(skip_locked=True)
                claimed = session.scalar(taken.where(JobRow.id == oldest.scalar_subquery()))
                if claimed is not None:
                    note_served(session, selection, turn)
                    row = found(session, JobRow, "job", claimed)
                    record(session, now, event_kinds.STARTED, row)
                    return Claim(read_job(row), selection)
            check_identity(session, self._files.folder)
            return None

    def heartbeat(self, claim: Claim, progress: Progress | None = None) -> bool:
        """Report that the attempt is alive, with its progress."""
        values: dict[str, Any] = {"beats": JobRow.beats + 1}
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

    def handed_over(self, job_id: str) -> AttemptInput:
        """Return the input of a job.

        Raises
        ------
        NotFound
            A resource that the job refers to, and does not keep, was deleted since the job was queued.
        StorageUnavailable
            The database does not answer.
        """
        with self._database.read() as session:
            return self._subjects.handed_over(session, self._files, found(session, JobRow, "job", job_id))

    def check_output(self, kind: JobKind, result: dict[str, Any], folder: Path) -> tuple[Contract, Path | None]:
        """Return the result that an attempt's process sent, and the file that it left, unopened; null: it left none."""
        answer: Contract = declaration_of(kind).result.model_validate(result)
        return answer, self._subjects.output_file(kind, folder)

    def digest_of_result(self, path: Path) -> bytes | None:
        """Return the digest that was taken of a result, by its path in the data folder; None: there is none."""
        with self._database.read() as session:
            digest = session.scalar(select(JobRow.output_sha256).where(_wrote(path)))
        return None if digest is None else bytes.fromhex(digest)

    def note_digest_of_result(self, path: Path, sha256: bytes) -> None:
        """Write the digest of a result of an earlier version to the job's row; the log has the reason if it cannot."""
        try:
            with self._database.write() as session:
                session.execute(update(JobRow).where(_wrote(path)).values(output_sha256=sha256.hex()))
        except (StorageFull, StorageUnavailable) as error:  # the file can be read all the same
            structlog.get_logger().warning("digest-not-noted", file=path.name, reason=str(error))

    def keep(self, claim: Claim, output: Path, names: Sequence[str]) -> None:
        """Keep an attempt's checkpoints with the job, and reset the count of losses: the job has made progress.

        Parameters
        ----------
        claim
            Claim of the attempt.
        output
            Folder of the attempt.
        names
            Names of the checkpoints in the folder.

        Raises
        ------
        LeaseLost
            The attempt no longer holds the job: earlier checkpoints do not change.
        """
        with self._database.write() as session:
            row = _held(session, claim)
            # Moved while the row is locked: a late attempt cannot replace checkpoints of a newer one.
            self._files.keep(output, claim.job_id, names)
            row.losses = row.outages = 0

    def succeed(
        self,
        claim: Claim,
        result: Contract,
        output: Path,
        *,
        sha256: bytes | None = None,
        peak_memory_bytes: int | None = None,
    ) -> None:
        """Publish an attempt's files and result, both or neither."""
        kind, subject_id = claim.job.kind, claim.job.subject_id
        with self._ending() as session:
            row = _held(session, claim)
            row.output_sha256 = None if sha256 is None else sha256.hex()
            event = self._end(
                session, row, JobState.SUCCEEDED, event_kinds.SUCCEEDED, detail=_measured(peak_memory_bytes)
            )
            recorded = self._subjects.record_success(session, kind, subject_id, result, self._database.now())
            event.why = recorded.why
            event.detail = {**(event.detail or {}), **recorded.detail} or None
            session.flush()
            # Renamed while the row is locked: a late attempt cannot replace a newer one's files. When the commit fails
            # the files stay: it may have come through. If not, the next attempt replaces them, or `leftovers` does.
            lock_files_of(session, subject_id)
            self._files.publish(output, self._files.results(kind, subject_id))

    def fail(
        self, claim: Claim, failure: Failure, *, retries: Retries = RETRIES, peak_memory_bytes: int | None = None
    ) -> JobState:
        """End an attempt that failed: after a passing failure the job waits in the queue, up to its last loss.

        Parameters
        ----------
        claim
            Claim of the attempt.
        failure
            Reason of the end.
        retries
            Number of losses allowed, and waits before retries.
        peak_memory_bytes
            The largest memory that the attempt's process held, for its event.

        Returns
        -------
        JobState
            `queued`, `failed`, or `cancelled` if a cancellation was requested.

        Raises
        ------
        LeaseLost
            The attempt no longer holds the job.
        """
        with self._ending() as session:
            row = _held(session, claim)
            self._fail(session, row, failure, retries, peak_memory_bytes)
            return row.state

    def cancelled(self, claim: Claim) -> None:
        """End a running job whose cancellation was requested (`request_cancel`), or raise `LeaseLost`."""
        with self._ending() as session:
            self._cancel(session, _held(session, claim))

    def release(self, claim: Claim) -> JobState:
        """Return a running job to the queue because its worker stops or other jobs go first, or raise `LeaseLost`.

        Returns
        -------
        JobState
            `queued`, or `cancelled` if a cancellation was requested.
        """
        with self._ending() as session:
            row = _held(session, claim)
            if row.cancel_requested:
                self._cancel(session, row)
            else:
                record(session, self._database.now(), event_kinds.GIVEN_BACK, row)
                requeue(row)
            return row.state

    def pulses(self) -> Sequence[Pulse]:
        """Return the pulses of all running jobs."""
        columns = (JobRow.id, JobRow.attempt, JobRow.beats, JobRow.cancel_requested)
        with self._database.read() as session:
            return [Pulse(*row) for row in session.execute(select(*columns).where(JobRow.state == JobState.RUNNING))]

    def is_silent_still(self, pulse: Pulse) -> bool:
        """Return whether no heartbeat has come since the pulse.

        The query is a write: while nobody can write, silence has no meaning.
        """
        asked = update(JobRow).where(_silent(pulse)).values(beats=JobRow.beats).returning(JobRow.id)
        with self._database.write() as session:
            return session.scalar(asked.execution_options(synchronize_session=False)) is not None

    def take_back(self, pulse: Pulse, *, retries: Retries = RETRIES) -> Job | None:
        """Take a job from an attempt that has sent no heartbeat since its pulse was seen.

        Returns
        -------
        Job or None
            The job in its new state: queued again, failed at the last loss (`worker-lost`), or cancelled on request.
            None: the attempt has ended, or a heartbeat has come.
        """
        with self._ending() as session:
            row = session.scalar(select(JobRow).where(_silent(pulse)).with_for_update())
            if row is None:
                return None
            lost = f"attempt {row.attempt} ended unanswered: its worker {row.worker!r} stopped or lost its connection"
            self._fail(session, row, Failure(kind=FailureKind.PASSING, code="worker-lost", detail=lost), retries)
            session.flush()
            return read_job(row)

    def queued_job_ids(
        self, *, older_than_s: float = 0.0, short: bool | None = None, limit: int | None = None
    ) -> Sequence[str]:
        """Return jobs that could have started that long ago, the first come first: their wake-up may be lost."""
        since = self._database.now() - timedelta(seconds=older_than_s)
        # An expression instead of the column, by which SQLite would find the rows and then sort all of them.
        ready = _claimable(since, Selection(short=short)).where(func.coalesce(JobRow.created_at, since) <= since)
        with self._database.read() as session:
            return session.scalars(ready.order_by(*FIRST_COME).limit(limit)).all()

    def could_start(self, selection: Selection) -> bool:
        """Return whether a job of a selection waits that could start now."""
        ready = _claimable(self._database.now(), selection).limit(1)
        with self._database.read() as session:
            return session.scalar(ready) is not None

    def is_short(self, job_id: str) -> bool:
        """Return whether the job exists and takes seconds."""
        with self._database.read() as session:
            return bool(session.scalar(select(JobRow.short).where(JobRow.id == job_id)))

    def short_job_is_held_up(self, workers: int) -> bool:
        """Return whether a short job could start now and long jobs keep this number of workers busy."""
        foreground = JobRow.priority < Priority.BACKGROUND  # background jobs give way, or have time
        long = select(func.count()).where(JobRow.state == JobState.RUNNING, ~JobRow.short, foreground)
        waiting = _claimable(self._database.now(), Selection(short=True)).where(foreground)
        with self._database.read() as session:
            return (session.scalar(long) or 0) >= workers and session.scalar(waiting.limit(1)) is not None

    def is_in_the_way(self, claim: Claim) -> bool:
        """Return whether an attempt's job is a background job by its row, and a more urgent job could start instead."""
        others = JobRow.priority < Priority.BACKGROUND
        # A worker that took a long job now may take a short one next.
        takes = replace(claim.selection, short=claim.selection.short or None)
        other = _claimable(self._database.now(), takes).where(others).limit(1)
        itself = select(JobRow.id).where(_held_by(claim), ~others)
        with self._database.read() as session:
            return session.scalar(other) is not None and session.scalar(itself) is not None

    def waiting_for(self, job_id: str) -> Sequence[str]:
        """Return queued jobs that needed this one and could start now."""
        needs_it = JobRow.id.in_(select(JobDependencyRow.job_id).where(JobDependencyRow.needs_job_id == job_id))
        with self._database.read() as session:
            return session.scalars(_claimable(self._database.now()).where(needs_it)).all()

    @contextmanager
    def _ending(self) -> Iterator[Session]:
        """Begin a transaction that may end jobs; after its commit, the checkpoints of these jobs are removed."""
        with self._database.write() as session:
            yield session
        for job_id in session.info.pop(_ENDED_HERE, ()):
            after_commit(partial(self._files.remove, self._files.kept_with(job_id)))

    def _described(self, session: Session, rows: Sequence[JobRow]) -> list[Job]:
        """Return jobs with their places in the queue and estimated times."""
        estimates = self._estimates.of(session, rows, self._database.now())
        return [read_job(row, estimates.get(row.id, NOTHING_KNOWN)) for row in rows]

    def _fail(
        self, session: Session, row: JobRow, failure: Failure, retries: Retries, peak_memory_bytes: int | None = None
    ) -> None:
        detail = failure.model_dump(mode="json")
        reported = detail | (_measured(peak_memory_bytes) or {})
        if failure.kind is FailureKind.PASSING:
            if row.cancel_requested:
                self._cancel(session, row)
                return
            now = self._database.now()
            if failure.code in _OUTAGES:
                row.outages += 1
                record(session, now, event_kinds.POSTPONED, row, reported)
                _wait(row, now, detail, retries.outage_wait_s, row.outages)
                return
            row.losses, row.outages = row.losses + 1, 0
            record(session, now, event_kinds.LOST, row, reported)
            if row.losses < retries.max_losses:
                _wait(row, now, detail, retries.loss_wait_s, row.losses)
                return
        row.failure = detail
        self._end(session, row, JobState.FAILED, event_kinds.FAILED, reason=failure.detail, detail=reported)

    def _cancel(self, session: Session, row: JobRow) -> None:
        self._database.spare_room.give_up_piece()
        self._end(session, row, JobState.CANCELLED, event_kinds.CANCELLED, reason=_CANCELLED)

    def _end(
        self,
        session: Session,
        row: JobRow,
        state: JobState,
        what: EventType,
        *,
        reason: str | None = None,
        detail: Json | None = None,
    ) -> EventRow:
        session.info.setdefault(_ENDED_HERE, []).append(row.id)
        row.state = state
        row.finished_at = self._database.now()
        row.not_before_s = row.waiting_for = None
        event = record(session, row.finished_at, what, row, detail)
        if reason is not None:
            self._subjects.record_end_without_result(session, row.kind, row.subject_id, reason, row.finished_at)
        return event


def _claimable(at: datetime, selection: Selection = ANY) -> Select[str]:
    """Select the ids of the jobs of a selection that could start at a time."""
    needed = aliased(JobRow)
    unfinished = exists().where(
        JobDependencyRow.job_id == JobRow.id, needed.id == JobDependencyRow.needs_job_id, needed.state.not_in(ENDED)
    )
    due = or_(JobRow.not_before_s.is_(None), JobRow.not_before_s <= at.timestamp())
    return select(JobRow.id).where(QUEUED, due, ~unfinished, *selection.conditions())


def _wrote(path: Path) -> ColumnElement[bool]:
    """Return the condition on the row of the job that wrote the file `<plural>/<id>/<name>`."""
    plural, subject_id = path.parts[-3:-1]
    kinds = [kind for kind in JobKind.all() if kind.plural == plural]
    return and_(JobRow.subject_id == subject_id, JobRow.kind.in_(kinds), JobRow.state == JobState.SUCCEEDED)


def _held_by(attempt: Claim | Pulse) -> ColumnElement[bool]:
    return and_(JobRow.id == attempt.job_id, JobRow.state == JobState.RUNNING, JobRow.attempt == attempt.attempt)


def _silent(pulse: Pulse) -> ColumnElement[bool]:
    return and_(_held_by(pulse), JobRow.beats == pulse.beats)


def _held(session: Session, claim: Claim) -> JobRow:
    row = session.scalar(select(JobRow).where(_held_by(claim)).with_for_update())
    if row is None:
        raise LeaseLost(claim.job_id, claim.attempt)
    return row


def _measured(peak_memory_bytes: int | None) -> Json | None:
    return None if peak_memory_bytes is None else {PEAK_MEMORY: peak_memory_bytes}


def requeue(row: JobRow) -> None:
    """Put a job back into its place in the queue."""
    row.state = JobState.QUEUED
    row.worker = row.started_at = row.progress = None


def _wait(row: JobRow, now: datetime, failure: Json, first_wait_s: float, time: int) -> None:
    """Put a job back into the queue until its wait is over: the first wait, the second one, and so on."""
    requeue(row)
    wait_s = min(first_wait_s * 2.0 ** min(time - 1, 30), LONGEST_WAIT_S)
    row.not_before_s = now.timestamp() + wait_s * random.uniform(1.0 - _JITTER, 1.0 + _JITTER)  # noqa: S311
    row.waiting_for = failure


def read_job(row: JobRow, estimate: WaitEstimate = NOTHING_KNOWN) -> Job:
    """Return the job of a row."""
    return Job.of_row(
        row,
        queue_position=estimate.queue_position,
        seconds_left=estimate.seconds_left,
        background=row.priority is Priority.BACKGROUND,
        not_before=None if row.not_before_s is None else datetime.fromtimestamp(row.not_before_s, UTC),
    )
