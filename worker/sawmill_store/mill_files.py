"""The data folder of a mill, in addition to the files of `sawmill_platform/files/file_store.py`.

uploads/{scans,phantoms}/<id>/  the uploaded file, unchanged
uploads/inspections/<id>/       the uploaded file, for a day; a scan made of it has a second name of the same bytes
inspections/<id>/               view.grey or sinogram.grey, a picture of what the file shows
scans/<id>/scan.h5              line integrals
calibrations/<id>/              result.h5; report.png and overlay.png, drawn from it at the first request
reconstructions/<id>/           volume.h5
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from sqlalchemy import or_, select
from sqlalchemy.orm import InstrumentedAttribute, aliased

from sawmill_contracts import kinds
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.inspections import FILE_KEPT
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import UNFINISHED, JobKind, JobState
from sawmill_platform.database.clock import Clock
from sawmill_platform.database.tables import JobDependencyRow, JobRow
from sawmill_platform.files.file_store import UPLOADED_FILE, FileStore
from sawmill_platform.files.named_folders import Ids, NamedFolder
from sawmill_store.mill_tables import AskedRow, PhantomRow, ScanRow, table_of

SCAN_FILE = "scan.h5"
VOLUME_FILE = "volume.h5"


class MillFiles(FileStore):
    """The data folder, with the files that pages and routes read."""

    def scan(self, scan_id: str) -> Path:
        """Return the canonical file of a scan, which `ingest` wrote, as `result` does."""
        return self.result(kinds.INGEST, scan_id, SCAN_FILE)

    def volume(self, reconstruction_id: str) -> Path:
        """Return the volume of a reconstruction, as `result` does."""
        return self.result(kinds.RECONSTRUCT, reconstruction_id, VOLUME_FILE)


def unfinished_needing(job_id: InstrumentedAttribute[str] | str) -> Ids:
    """Select the unfinished jobs that need a job, by its id or by a column with ids."""
    needing = aliased(JobRow)
    dependent = select(needing.id).join(JobDependencyRow, JobDependencyRow.job_id == needing.id)
    return dependent.where(JobDependencyRow.needs_job_id == job_id, needing.state.in_(UNFINISHED))


def _inspected(now: Clock) -> Ids:
    """Select the inspections whose file is kept: for `FILE_KEPT`, and longer while a job needs it."""
    needed = unfinished_needing(AskedRow.job_id).correlate(AskedRow).exists()
    kept = or_(AskedRow.created_at > now() - FILE_KEPT, JobRow.state.in_(UNFINISHED), needed)
    return select(AskedRow.id).join(AskedRow.job).where(JobRow.kind == kinds.INSPECT, kept)


def _succeeded(kind: JobKind, _: Clock) -> Ids:
    table = table_of(kind)
    ended = select(table.id).join(JobRow, table.job_id == JobRow.id)
    return ended.where(JobRow.kind == kind, JobRow.state == JobState.SUCCEEDED)


# Folders of uploads, and of results by kind of job.
NAMED_FOLDERS: Sequence[NamedFolder] = (
    NamedFolder("uploads/scans", lambda _: select(ScanRow.id), UPLOADED_FILE),
    NamedFolder("uploads/phantoms", lambda _: select(PhantomRow.id)),
    NamedFolder("uploads/inspections", _inspected),
    NamedFolder("scans", lambda _: select(ScanRow.id).where(ScanRow.state == ScanState.READY), SCAN_FILE),
    NamedFolder("phantoms", lambda _: select(PhantomRow.id).where(PhantomRow.state == PhantomState.READY)),
    *(
        NamedFolder(declared.kind.plural, partial(_succeeded, declared.kind), declared.result_file)
        for declared in asked_kinds()
    ),
)
