"""Reconstructions: asked for, and computed by a job."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_worker.contracts.base import Page
from sawmill_worker.contracts.jobs import JobKind, JobState
from sawmill_worker.contracts.reconstructions import Reconstruction, ReconstructionAsk
from sawmill_worker.contracts.scans import ScanState
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.errors import Conflict
from sawmill_worker.storage.paging import found, narrowed, new_id, read_page, refuse_taken
from sawmill_worker.storage.queueing import queue_job
from sawmill_worker.storage.scanners import active_calibration_id
from sawmill_worker.storage.scans import usable_scan
from sawmill_worker.storage.tables import CalibrationRow, JobRow, ReconstructionRow, ScanRow


class Reconstructions:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def accept(
        self, ask: ReconstructionAsk, *, reconstruction_id: str | None = None, background: bool = False
    ) -> Reconstruction:
        """Queue a reconstruction; while its scan is being read or its calibration computed, it waits for them.

        Without a calibration and without a theta, the scanner's active calibration is taken, as it is now.
        In the `background` it starts only when no other job could.

        Raises
        ------
        NotFound
            There is no such scan or calibration.
        Conflict
            The scan was refused, the calibration failed or belongs to another scanner, no calibration is active,
            or the id is taken.
        """
        identifier = reconstruction_id or new_id()
        now = self._database.now()
        with self._database.write() as session:
            refuse_taken(session, ReconstructionRow, "reconstruction", identifier)
            scan = usable_scan(session, ask.scan_id)
            needs = [scan.job_id] if scan.state is ScanState.INGESTING else []
            calibration = (
                None
                if ask.theta is not None
                else usable_calibration(session, scan, ask.calibration_id, instead=", or give theta")
            )
            if calibration is not None and not calibration.job.state.ended:
                needs.append(calibration.job_id)
            calibration_id = calibration.id if calibration is not None else None
            row = ReconstructionRow(
                id=identifier,
                created_at=now,
                scanner_id=scan.scanner_id,
                scan_id=scan.id,
                calibration_id=calibration_id,
                options=ask.model_copy(update={"calibration_id": calibration_id}).model_dump(mode="json"),
                job_id=queue_job(session, JobKind.RECONSTRUCT, identifier, now, needs=needs, background=background),
            )
            session.add(row)
            session.flush()
            session.refresh(row, ["job"])
            return _read(row)

    def get(self, reconstruction_id: str) -> Reconstruction:
        """One reconstruction, or `NotFound`."""
        with self._database.read() as session:
            return _read(found(session, ReconstructionRow, "reconstruction", reconstruction_id))

    def page(
        self,
        *,
        scanner_id: str | None = None,
        scan_id: str | None = None,
        state: JobState | None = None,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[Reconstruction]:
        """Reconstructions, newest first."""
        wanted = {ReconstructionRow.scanner_id: scanner_id, ReconstructionRow.scan_id: scan_id, JobRow.state: state}
        statement = narrowed(select(ReconstructionRow).join(ReconstructionRow.job), wanted)
        with self._database.read() as session:
            return read_page(session, statement, ReconstructionRow, _read, after=after, limit=limit)


def usable_calibration(session: Session, scan: ScanRow, asked: str | None, *, instead: str) -> CalibrationRow:
    """The calibration asked for, or the active one of the scan's scanner; it may still be computed.

    Parameters
    ----------
    instead
        What else the asker could give, for the sentence of a scanner that has no active one.

    Raises
    ------
    NotFound, Conflict
        There is none, it belongs to another scanner, or it ended without a result.
    """
    calibration_id = asked or active_calibration_id(session, scan.scanner_id)
    if calibration_id is None:
        msg = f"scanner {scan.scanner_id!r} has no active calibration: name one as calibration_id{instead}"
        raise Conflict("no-active-calibration", msg)
    calibration = found(session, CalibrationRow, "calibration", calibration_id)
    if calibration.scanner_id != scan.scanner_id:
        msg = (
            f"calibration {calibration_id!r} is of scanner {calibration.scanner_id!r}, "
            f"but scan {scan.id!r} is of scanner {scan.scanner_id!r}"
        )
        raise Conflict("scanner-mismatch", msg)
    if calibration.job.state in {JobState.FAILED, JobState.CANCELLED}:
        msg = f"calibration {calibration_id!r} {_ENDED[calibration.job.state]} and has no geometry to use"
        raise Conflict("calibration-without-result", msg)
    return calibration


_ENDED = {JobState.FAILED: "failed", JobState.CANCELLED: "was cancelled"}


def _read(row: ReconstructionRow) -> Reconstruction:
    return Reconstruction.model_validate(
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
