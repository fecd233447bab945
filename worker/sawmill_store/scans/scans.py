"""Scans and inspections: uploads, and the results of the jobs that read or inspect the uploads."""

from collections.abc import Collection
from datetime import datetime

from sqlalchemy import func, select

from sawmill_contracts import kinds, mill_events, scans
from sawmill_contracts.inspections import Inspection, InspectionOptions, InspectionRequest
from sawmill_contracts.scans import Scan, ScanSpec, ScanState
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.database.paging import created_between, found, narrowed, new_id, read_page, refuse_taken
from sawmill_platform.errors import Conflict
from sawmill_platform.files.upload_stream import Received
from sawmill_platform.ledger.events import announce
from sawmill_platform.uploads.upload_store import kept_upload
from sawmill_store.mill_files import unfinished_needing
from sawmill_store.mill_tables import PhantomRow, ScannerRow, ScanRow
from sawmill_store.queuing import QueuingPart
from sawmill_store.requests.asked import Asked
from sawmill_store.requests.references import found_asked, inspections_file_gone, read_asked, unfinished_job_about

_COLUMNS = {"scanner_id", "phantom_id"}


class Scans(QueuingPart):
    """Store of scans."""

    def accept(
        self,
        spec: ScanSpec,
        received: Received,
        *,
        scan_id: str | None = None,
        priority: Priority = Priority.INTERACTIVE,
    ) -> Scan:
        """Keep an upload and queue the job that reads it.

        Parameters
        ----------
        spec
            Description that the uploader gives with the file.
        received
            The upload, from `FileStore.receive`. When this method raises, the upload is discarded.
        scan_id
            A fixed id; null for a new one.
        priority
            Priority of the job in the queue.

        Raises
        ------
        NotFound, Conflict
            There is no such scanner or phantom, or the id is taken.
        QueueFull
            The allowed number of jobs is waiting already.
        """
        row = ScanRow(
            id=scan_id or new_id(),
            created_at=self._database.now(),
            scanner_id=spec.scanner_id,
            phantom_id=spec.phantom_id,
            spec=spec.model_dump(mode="json", exclude=_COLUMNS),
            state=ScanState.INGESTING,
            size_bytes=received.size_bytes,
            sha256=received.sha256,
        )
        with kept_upload(self.files, received, kinds.INGEST, row.id) as keep, self._database.write() as session:
            refuse_taken(session, ScanRow, "scan", row.id)
            found(session, ScannerRow, "scanner", spec.scanner_id, lock=True)
            if spec.phantom_id is not None:
                found(session, PhantomRow, "phantom", spec.phantom_id, lock=True)
            self._add_with_job(session, row, scans.DECLARATION, received, group_id=spec.scanner_id, priority=priority)
            keep(session, row.created_at)
        return read_scan(row)

    def check(self, spec: ScanSpec) -> None:
        """Refuse, before a file is sent, a scan that `accept` would refuse after the upload.

        Raises
        ------
        NotFound
            There is no such scanner or phantom.
        QueueFull
            The allowed number of jobs is waiting already.
        StorageUnavailable
            The database does not answer, or could not take the scan.
        """
        self._database.check_writable()
        with self._database.read() as session:
            found(session, ScannerRow, "scanner", spec.scanner_id)
            if spec.phantom_id is not None:
                found(session, PhantomRow, "phantom", spec.phantom_id)
        self._places.check()

    def get(self, scan_id: str) -> Scan:
        """Return a scan, or raise `NotFound`."""
        with self._database.read() as session:
            return read_scan(found(session, ScanRow, "scan", scan_id))

    def several(self, scan_ids: Collection[str]) -> dict[str, Scan]:
        """Return the scans of these ids that exist, by id."""
        with self._database.read() as session:
            return {row.id: read_scan(row) for row in session.scalars(select(ScanRow).where(ScanRow.id.in_(scan_ids)))}

    def page(
        self,
        *,
        scanner_id: str | None = None,
        state: ScanState | None = None,
        created_from: datetime | None = None,
        created_before: datetime | None = None,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[Scan]:
        """Return a page of scans, newest first, within a span of time if one is given."""
        statement = narrowed(select(ScanRow), {ScanRow.scanner_id: scanner_id, ScanRow.state: state})
        statement = created_between(statement, ScanRow, created_from, created_before)
        with self._database.read() as session:
            return read_page(session, statement, ScanRow, read_scan, after=after, limit=limit)

    def uploaded_bytes(self) -> int:
        """Return the size of all uploaded files of scans, bytes."""
        with self._database.read() as session:
            return session.scalar(select(func.sum(ScanRow.size_bytes))) or 0

    def delete(self, scan_id: str) -> None:
        """Remove a scan, and its files after the commit; calibrations and reconstructions made from it stay.

        Raises
        ------
        NotFound, Conflict
            There is no such scan, or a job that needs it has not ended.
        """
        with self._database.write() as session:
            row = found(session, ScanRow, "scan", scan_id, lock=True)
            reading = None if row.state is not ScanState.INGESTING else row.job_id
            busy = reading or unfinished_job_about(session, scan_id)
            if busy is not None:
                raise Conflict(
                    "scan-in-use",
                    f"scan {scan_id!r} is needed by job {busy!r}, which has not ended; cancel it or wait for it",
                )
            details = {"scanner_id": row.scanner_id, "sha256": row.sha256}
            now = self._database.now()
            announce(session, now, mill_events.SCAN_DELETED, "scan", scan_id, group_id=row.scanner_id, decided=details)
            session.delete(row)
        self.files.remove(self.files.results(kinds.INGEST, scan_id))
        self.files.remove_upload(kinds.INGEST, scan_id)


def read_scan(row: ScanRow) -> Scan:
    """Read the scan of a row."""
    stated = row.spec | (row.reading or {})
    return Scan.of_row(row, **{name: value for name, value in stated.items() if not hasattr(row, name)})


class Inspections(Asked[InspectionRequest, Inspection]):
    """Store of inspections and of the inspected files."""

    def accept_file(
        self,
        options: InspectionOptions,
        received: Received,
        *,
        name: str = "file",
        identifier: str | None = None,
        priority: Priority = Priority.INTERACTIVE,
    ) -> Inspection:
        """Keep an upload and queue the job that inspects it.

        Parameters
        ----------
        options
            Options that the uploader gives with the file.
        received
            The upload, from `FileStore.receive`. When this method raises, the upload is discarded.
        name
            Name of the file in the answer.
        identifier
            A fixed id; null for a new one.
        priority
            Priority of the job in the queue.

        Raises
        ------
        Conflict
            The id is taken.
        QueueFull
            The allowed number of jobs is waiting already.
        """
        file = InspectionRequest(
            **options.model_dump(), name=name, size_bytes=received.size_bytes, sha256=received.sha256
        )
        identifier = identifier or new_id()
        with kept_upload(self.files, received, kinds.INSPECT, identifier) as keep, self._database.write() as session:
            now = self._database.now()
            row = self.queue(session, file, now, identifier=identifier, priority=priority)
            keep(session, now)
            return read_asked(self._declared, row)

    def received_again(self, identifier: str) -> Received:
        """Receive the inspected file as if it were sent again; `accept` or `discard` must follow, as after an upload.

        Raises
        ------
        NotFound, Conflict
            There is no such inspection, or its file has been removed.
        """
        file = self.get(identifier).options
        again = self.files.second_name(
            self.files.upload(kinds.INSPECT, identifier), size_bytes=file.size_bytes, sha256=file.sha256
        )
        if again is None:
            raise inspections_file_gone(identifier)
        return again

    def delete(self, identifier: str) -> None:
        """Remove an inspection, and its file after the commit; scans made of the inspection keep their files.

        Raises
        ------
        NotFound, Conflict
            There is no such inspection, or its job has not ended.
        """
        with self._database.write() as session:
            row = found_asked(session, self._declared, identifier)
            busy = row.job_id if not row.job.state.ended else session.scalar(unfinished_needing(row.job_id).limit(1))
            if busy is not None:
                raise Conflict(
                    "inspection-in-use",
                    f"job {busy!r} still needs the file of {identifier!r}; cancel it or wait for it",
                )
            details = {"sha256": row.options["sha256"]}
            now = self._database.now()
            announce(session, now, mill_events.INSPECTION_DELETED, "inspection", identifier, decided=details)
            session.delete(row)
        self.files.remove(self.files.results(kinds.INSPECT, identifier))
        self.files.remove_upload(kinds.INSPECT, identifier)
