"""Looks at drift: asked for, and computed by a job."""

from sqlalchemy import select

from sawmill_worker.contracts.base import Page
from sawmill_worker.contracts.drifts import Drift, DriftAsk, DriftOptions
from sawmill_worker.contracts.jobs import JobKind, JobState
from sawmill_worker.contracts.scans import ScanState
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.paging import found, narrowed, new_id, read_page, refuse_taken
from sawmill_worker.storage.queueing import queue_job
from sawmill_worker.storage.reconstructions import usable_calibration
from sawmill_worker.storage.scans import usable_scan
from sawmill_worker.storage.tables import DriftRow, JobRow


class Drifts:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def accept(self, ask: DriftAsk, *, drift_id: str | None = None, background: bool = False) -> Drift:
        """Queue a look at drift; while its scan is being read or its calibration computed, it waits for them.

        Without a calibration the scanner's active one is taken, as it is now.
        In the `background` it starts only when no other job could.

        Raises
        ------
        NotFound
            There is no such scan or calibration.
        Conflict
            The scan was refused, the calibration failed or belongs to another scanner, no calibration is active,
            or the id is taken.
        """
        identifier = drift_id or new_id()
        now = self._database.now()
        with self._database.write() as session:
            refuse_taken(session, DriftRow, "drift", identifier)
            scan = usable_scan(session, ask.scan_id)
            calibration = usable_calibration(session, scan, ask.calibration_id, instead="")
            needs = [scan.job_id] if scan.state is ScanState.INGESTING else []
            if not calibration.job.state.ended:
                needs.append(calibration.job_id)
            options = DriftOptions.model_validate(ask.model_dump(include=set(DriftOptions.model_fields)))
            row = DriftRow(
                id=identifier,
                created_at=now,
                scanner_id=scan.scanner_id,
                scan_id=scan.id,
                calibration_id=calibration.id,
                options=options.model_dump(mode="json"),
                job_id=queue_job(session, JobKind.DRIFT, identifier, now, needs=needs, background=background),
            )
            session.add(row)
            session.flush()
            session.refresh(row, ["job"])
            return _read(row)

    def get(self, drift_id: str) -> Drift:
        """One look at drift, or `NotFound`."""
        with self._database.read() as session:
            return _read(found(session, DriftRow, "drift", drift_id))

    def page(
        self,
        *,
        scanner_id: str | None = None,
        scan_id: str | None = None,
        state: JobState | None = None,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[Drift]:
        """Looks at drift, newest first."""
        wanted = {DriftRow.scanner_id: scanner_id, DriftRow.scan_id: scan_id, JobRow.state: state}
        statement = narrowed(select(DriftRow).join(DriftRow.job), wanted)
        with self._database.read() as session:
            return read_page(session, statement, DriftRow, _read, after=after, limit=limit)


def _read(row: DriftRow) -> Drift:
    return Drift.model_validate(
        {
            "id": row.id,
            "created_at": row.created_at,
            "state": row.job.state,
            "scanner_id": row.scanner_id,
            "scan_id": row.scan_id,
            "calibration_id": row.calibration_id,
            "job_id": row.job_id,
            "options": row.options,
            "result": row.result,
            "failure": row.job.failure,
        }
    )
