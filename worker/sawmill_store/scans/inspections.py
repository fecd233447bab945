"""Inspections: uploads that are inspected before they become scans."""

from sawmill_contracts import kinds, mill_events
from sawmill_contracts.inspections import DECLARATION, Inspection, InspectionOptions, InspectionRequest
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import new_id
from sawmill_platform.errors import Conflict
from sawmill_platform.files.upload_stream import Received
from sawmill_platform.jobs.queue_limits import Places
from sawmill_platform.ledger.events import announce
from sawmill_platform.uploads.upload_store import kept_upload
from sawmill_store.mill_files import MillFiles
from sawmill_store.requests.asked import Asked
from sawmill_store.requests.references import found_asked, read_asked


class Inspections(Asked[InspectionRequest, Inspection]):
    """Store of inspections and of the inspected files: every method is one transaction."""

    def __init__(self, database: Database, files: MillFiles, places: Places) -> None:
        super().__init__(database, files, places, DECLARATION)

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
            raise Conflict(
                "inspection-expired",
                f"the file of inspection {identifier!r} has been removed, a day after it came: send it again",
            )
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
            if not row.job.state.ended:
                raise Conflict(
                    "inspection-in-use",
                    f"job {row.job_id!r} still inspects the file of {identifier!r}; cancel it or wait for it",
                )
            details = {"sha256": row.options["sha256"]}
            now = self._database.now()
            announce(session, now, mill_events.INSPECTION_DELETED, "inspection", identifier, decided=details)
            session.delete(row)
        self.files.remove(self.files.results(kinds.INSPECT, identifier))
        self.files.remove_upload(kinds.INSPECT, identifier)
