"""Calibrations: asked for, computed by a job, made active."""

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_worker.contracts.base import Page
from sawmill_worker.contracts.calibrations import (
    CalibrationAsk,
    CalibrationOptions,
    CalibrationSucceeded,
    CalibrationUnfinished,
    calibration_from,
)
from sawmill_worker.contracts.jobs import JobKind, JobState
from sawmill_worker.contracts.phantoms import PhantomState
from sawmill_worker.contracts.scanners import Scanner
from sawmill_worker.contracts.scans import ScanState
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.errors import Conflict
from sawmill_worker.storage.paging import found, narrowed, new_id, read_page, refuse_taken
from sawmill_worker.storage.queueing import queue_job
from sawmill_worker.storage.scanners import activate, read_scanner
from sawmill_worker.storage.scans import usable_scan
from sawmill_worker.storage.tables import CalibrationRow, JobRow, PhantomRow, ScannerRow, ScanRow

CalibrationAnswer = CalibrationUnfinished | CalibrationSucceeded


class Calibrations:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def accept(
        self,
        ask: CalibrationAsk,
        *,
        calibration_id: str | None = None,
        job_id: str | None = None,
        background: bool = False,
    ) -> CalibrationAnswer:
        """Queue a calibration; while the scan or the phantom's picture is still being read, it waits for that.

        Parameters
        ----------
        ask
            What to calibrate, and how.
        calibration_id, job_id
            Fixed ids; null for new ones.
        background
            Only when no other job could start.

        Raises
        ------
        NotFound
            There is no such scan or phantom.
        Conflict
            The scan or phantom was refused, the scan names no phantom and neither does the ask, or an id is taken.
        """
        with self._database.write() as session:
            row = queue_calibration(
                session,
                ask,
                self._database.now(),
                calibration_id=calibration_id,
                job_id=job_id,
                background=background,
            )
            return _read(row)

    def get(self, calibration_id: str) -> CalibrationAnswer:
        """One calibration, or `NotFound`."""
        with self._database.read() as session:
            return _read(found(session, CalibrationRow, "calibration", calibration_id))

    def page(
        self,
        *,
        scanner_id: str | None = None,
        scan_id: str | None = None,
        state: JobState | None = None,
        after: str | None = None,
        limit: int = 50,
    ) -> Page[CalibrationAnswer]:
        """Calibrations, newest first."""
        wanted = {CalibrationRow.scanner_id: scanner_id, CalibrationRow.scan_id: scan_id, JobRow.state: state}
        statement = narrowed(select(CalibrationRow).join(CalibrationRow.job), wanted)
        with self._database.read() as session:
            return read_page(session, statement, CalibrationRow, _read, after=after, limit=limit)

    def activate(self, calibration_id: str, reason: str) -> Scanner:
        """Make a calibration its scanner's active one, or go back to an older one.

        Parameters
        ----------
        calibration_id
            One that has succeeded, whatever its verdict: the technician decides.
        reason
            Who or what activates it, for the history.

        Raises
        ------
        NotFound, Conflict
            There is none, or it has no result.
        """
        with self._database.write() as session:
            row = found(session, CalibrationRow, "calibration", calibration_id)
            if row.result is None:
                msg = f"calibration {calibration_id!r} is {row.job.state}; only one that succeeded can be activated"
                raise Conflict("calibration-without-result", msg)
            scanner = found(session, ScannerRow, "scanner", row.scanner_id, lock=True)
            activate(session, scanner.id, row.id, reason, self._database.now())
            return read_scanner(session, scanner)


def queue_calibration(
    session: Session,
    ask: CalibrationAsk,
    now: datetime,
    *,
    schedule_id: str | None = None,
    calibration_id: str | None = None,
    job_id: str | None = None,
    background: bool = False,
) -> CalibrationRow:
    """Write a calibration and its job inside the caller's transaction; errors as in `Calibrations.accept`."""
    calibration_id = calibration_id or new_id()
    refuse_taken(session, CalibrationRow, "calibration", calibration_id)
    scan = usable_scan(session, ask.scan_id)
    phantom = _usable_phantom(session, scan, ask.phantom_id)
    needs = [scan.job_id] if scan.state is ScanState.INGESTING else []
    if phantom.state is PhantomState.TRACING and phantom.job_id is not None:
        needs.append(phantom.job_id)
    options = CalibrationOptions.model_validate(ask.model_dump(exclude={"scan_id", "phantom_id", "activate"}))
    row = CalibrationRow(
        id=calibration_id,
        created_at=now,
        scanner_id=scan.scanner_id,
        scan_id=scan.id,
        phantom_id=phantom.id,
        schedule_id=schedule_id,
        options=options.model_dump(mode="json"),
        activate=ask.activate,
        job_id=queue_job(
            session, JobKind.CALIBRATE, calibration_id, now, needs=needs, job_id=job_id, background=background
        ),
    )
    session.add(row)
    session.flush()
    session.refresh(row, ["job"])
    return row


def _usable_phantom(session: Session, scan: ScanRow, asked: str | None) -> PhantomRow:
    phantom_id = asked or scan.phantom_id
    if phantom_id is None:
        raise Conflict("phantom-not-named", f"scan {scan.id!r} names no phantom: say which one it shows, as phantom_id")
    phantom = found(session, PhantomRow, "phantom", phantom_id, lock=True)
    if phantom.state is PhantomState.REFUSED:
        msg = f"phantom {phantom_id!r} was refused and cannot be used: {phantom.reason}"
        raise Conflict("phantom-refused", msg)
    return phantom


def _read(row: CalibrationRow) -> CalibrationAnswer:
    header = {
        "id": row.id,
        "created_at": row.created_at,
        "scanner_id": row.scanner_id,
        "scan_id": row.scan_id,
        "phantom_id": row.phantom_id,
        "job_id": row.job_id,
        "schedule_id": row.schedule_id,
        "options": row.options,
    }
    if row.result is None:
        header["failure"] = row.job.failure
    return calibration_from(header, row.job.state, row.result)
