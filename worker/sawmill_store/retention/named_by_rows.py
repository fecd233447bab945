"""Names in the data folder that rows know: statements that select ids, to which a condition may be added."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import Connection, Select, or_, select

from sawmill_contracts import job_kinds
from sawmill_contracts.inspections import FILE_KEPT
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import UNFINISHED, JobKind, JobState
from sawmill_platform.contracts.uploads import UploadState
from sawmill_platform.database.tables import JobRow, UploadRow
from sawmill_store.tables import AskedRow, PhantomRow, ScanRow, table_of

Ids = Select[str]

# Kinds of jobs that read an upload.
UPLOADED = (job_kinds.INGEST, job_kinds.TRACE_PHANTOM, job_kinds.INSPECT)
_WITH_FILES = (job_kinds.CALIBRATE, job_kinds.RECONSTRUCT)
_LOOKED_AT = 100


def unfinished_jobs() -> Ids:
    """Select the jobs that may have checkpoints in `kept`."""
    return select(JobRow.id).where(JobRow.state.in_(UNFINISHED))


def unused_uploads() -> Ids:
    """Select the uploads that may have a file in `unfinished`."""
    return select(UploadRow.id).where(UploadRow.state != UploadState.USED)


def uploaded(kind: JobKind, now: Callable[[], datetime]) -> Ids:
    """Select the subjects of one of the kinds `UPLOADED` whose uploaded file is kept.

    An inspection's file is kept for `FILE_KEPT`, and longer while the job of the inspection has not ended.
    """
    if kind is job_kinds.INGEST:
        return select(ScanRow.id)
    if kind is job_kinds.TRACE_PHANTOM:
        return select(PhantomRow.id)
    kept = or_(AskedRow.created_at > now() - FILE_KEPT, JobRow.state.in_(UNFINISHED))
    return select(AskedRow.id).join(AskedRow.job).where(JobRow.kind == job_kinds.INSPECT, kept)


def succeeded(kind: JobKind) -> Ids:
    """Select the subjects for which jobs of a kind have written results."""
    if kind is job_kinds.INGEST:
        return select(ScanRow.id).where(ScanRow.state == ScanState.READY)
    if kind is job_kinds.TRACE_PHANTOM:
        return select(PhantomRow.id).where(PhantomRow.state == PhantomState.READY)
    table = table_of(kind)
    ended = select(table.id).join(JobRow, table.job_id == JobRow.id)
    return ended.where(JobRow.kind == kind, JobRow.state == JobState.SUCCEEDED)


def first_named(connection: Connection, folder: Path) -> list[Path]:
    """Return some of the folders below a data folder that rows name."""
    uploads = uploaded(job_kinds.INGEST, lambda: datetime.now(UTC))
    named = {f"uploads/{job_kinds.INGEST.plural}": uploads} | {kind.plural: succeeded(kind) for kind in _WITH_FILES}
    return [folder / name / each for name, ids in named.items() for each in connection.scalars(ids.limit(_LOOKED_AT))]
