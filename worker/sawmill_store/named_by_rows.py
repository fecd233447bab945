"""Which names in the data folder rows know: statements that give ids, of all or of some by a further condition."""

from collections.abc import Callable
from datetime import datetime

from sqlalchemy import Select, or_, select

from sawmill_contracts.inspections import FILE_KEPT
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import UNFINISHED, JobKind, JobState
from sawmill_platform.contracts.uploads import UploadState
from sawmill_platform.database.tables import AskedRow, JobRow, PhantomRow, ScanRow, UploadRow, table_of

Ids = Select[str]

# Jobs that read what was uploaded for them.
UPLOADED = (JobKind.INGEST, JobKind.TRACE_PHANTOM, JobKind.INSPECT)


def unfinished_jobs() -> Ids:
    """Jobs that may have checkpoints in `kept`."""
    return select(JobRow.id).where(JobRow.state.in_(UNFINISHED))


def unused_uploads() -> Ids:
    """Uploads that may have a file in `unfinished`."""
    return select(UploadRow.id).where(UploadRow.state != UploadState.USED)


def uploaded(kind: JobKind, now: Callable[[], datetime]) -> Ids:
    """What files were uploaded for, by one of the kinds `UPLOADED`.

    An inspection's file is kept for its time, or until it has been inspected.
    """
    if kind is JobKind.INGEST:
        return select(ScanRow.id)
    if kind is JobKind.TRACE_PHANTOM:
        return select(PhantomRow.id)
    kept = or_(AskedRow.created_at > now() - FILE_KEPT, JobRow.state.in_(UNFINISHED))
    return select(AskedRow.id).join(AskedRow.job).where(JobRow.kind == JobKind.INSPECT, kept)


def succeeded(kind: JobKind) -> Ids:
    """What jobs of a kind have left results of."""
    if kind is JobKind.INGEST:
        return select(ScanRow.id).where(ScanRow.state == ScanState.READY)
    if kind is JobKind.TRACE_PHANTOM:
        return select(PhantomRow.id).where(PhantomRow.state == PhantomState.READY)
    table = table_of(kind)
    ended = select(table.id).join(JobRow, table.job_id == JobRow.id)
    return ended.where(JobRow.kind == kind, JobRow.state == JobState.SUCCEEDED)
