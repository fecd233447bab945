"""The base of stores that queue jobs for their rows."""

from sqlalchemy.orm import Session

from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.contracts.kind_declarations import UploadedKind
from sawmill_platform.database.database import Database, StorePart
from sawmill_platform.files.upload_stream import Received
from sawmill_platform.jobs.queue_limits import Places, queue_job
from sawmill_store.mill_files import MillFiles
from sawmill_store.mill_tables import PhantomRow, ScanRow


class QueuingPart(StorePart):
    """Part of a store that queues jobs, within the limit of waiting jobs."""

    def __init__(self, database: Database, files: MillFiles, places: Places) -> None:
        super().__init__(database)
        self.files = files
        self._places = places

    def _add_with_job(
        self,
        session: Session,
        row: ScanRow | PhantomRow,
        declared: UploadedKind,
        received: Received,
        *,
        group_id: str | None,
        priority: Priority,
    ) -> None:
        """Add the row of an upload, and queue the job that reads the upload."""
        short = declared.is_short(received.size_bytes)
        job = queue_job(
            session, declared.kind, row.id, row.created_at, short=short, group_id=group_id, priority=priority
        )
        row.job_id = job.id
        session.add(row)
        session.flush()
        self._places.take(session, job)
