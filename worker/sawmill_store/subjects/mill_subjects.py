"""Subjects of a mill's jobs for the job store, and the input of a job, which the worker reads from the rows."""

from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from sawmill_contracts import calibrations, fixed_pairs, kinds, mill_events
from sawmill_contracts.calibrations import Calibration, CalibrationResult
from sawmill_contracts.drifts import DriftResult
from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.kinds import AskedKind, Reference
from sawmill_contracts.phantoms import PhantomState, StoredPhantom
from sawmill_contracts.scans import ScanState
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.reading_apart import read_apart
from sawmill_mill.next_step import step_alone, step_of_check
from sawmill_mill.scanner_state import activation_reason
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.database.paging import found
from sawmill_platform.database.tables import JobRow
from sawmill_platform.errors import DamagedResult
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.jobs.tallies import Recorded, Subjects
from sawmill_platform.ledger.events import THE_SERVICE, Actor, acting_as, announce
from sawmill_store.activations import activate
from sawmill_store.drift.drift_charts import known_baselines
from sawmill_store.drift.measurements import record_measurement
from sawmill_store.mill_files import NAMED_FOLDERS, SCAN_FILE
from sawmill_store.mill_tables import AskedRow, CalibrationRow, PhantomRow, ScannerRow, ScanRow
from sawmill_store.requests.references import found_asked, read_asked
from sawmill_store.scanners.scanners import read_scanner
from sawmill_store.scans.phantoms import picture_of
from sawmill_store.scans.scans import read_scan
from sawmill_store.subjects.outputs import output_file


def handed_over(session: Session, files: FileStore, job: JobRow) -> HandedOver:
    """Read the input of a job.

    Raises
    ------
    NotFound
        A referenced row was deleted since the request, such as a plan's phantom, whose deletion a plan does not block.
    """
    kept = files.kept_with(job.id)
    declared = declaration_of(job.kind)
    if isinstance(declared, AskedKind):
        return HandedOver(kept=kept, **_of_asked(session, files, declared, job.subject_id))
    file = files.upload(job.kind, job.subject_id)
    if job.kind is kinds.TRACE_PHANTOM:
        picture = picture_of(found(session, PhantomRow, "phantom", job.subject_id))
        return HandedOver(kept=kept, file=file, picture=picture)
    scan = found(session, ScanRow, "scan", job.subject_id)
    scanner = read_scanner(session, found(session, ScannerRow, "scanner", scan.scanner_id))
    return HandedOver(kept=kept, file=file, scan=read_scan(scan), scanner=scanner)


def _of_asked(session: Session, files: FileStore, declared: AskedKind[Any, Any], subject_id: str) -> dict[str, Any]:
    """Return the fields of `HandedOver` for the references that the row has."""
    answer = read_asked(declared, found_asked(session, declared, subject_id))
    fields: dict[str, Any] = {"asked_json": answer.model_dump_json()}
    if hasattr(answer, "scan_id"):
        scan = found(session, ScanRow, "scan", answer.scan_id)
        fields["scan"] = read_scan(scan)
        if scan.state is ScanState.READY:
            fields["file"] = files.results(kinds.INGEST, scan.id) / SCAN_FILE
    if hasattr(answer, "phantom_id"):
        fields["phantom"] = StoredPhantom.of_row(found(session, PhantomRow, "phantom", answer.phantom_id))
    if declared.upload is not None:
        fields["file"] = files.upload(declared.kind, subject_id)
    if Reference.INSPECTION in declared.references:
        inspected = [found(session, AskedRow, "inspection", each) for each in answer.options.inspection_ids]
        fields["files"] = [files.upload(kinds.INSPECT, row.id) for row in inspected]
    if Reference.FIXED_PAIRS in declared.references:
        calibrated = found_asked(session, fixed_pairs.DECLARATION, answer.options.fixed_pairs_id)
        fields["fixed_pairs"] = read_asked(fixed_pairs.DECLARATION, calibrated)
    if not hasattr(answer, "scanner_id"):
        return fields
    scanner = read_scanner(session, found(session, ScannerRow, "scanner", answer.scanner_id))
    fields["scanner"] = scanner
    if hasattr(answer, "calibration_id"):
        fields["calibration"] = _calibration(session, answer.calibration_id)
        if declared.kind is kinds.DRIFT:
            fields["baselines"] = known_baselines(session, answer.scanner_id, answer.calibration_id)
    elif hasattr(answer, "scan_id"):
        fields["active"] = _calibration(session, scanner.active_calibration_id)
    return fields


def _calibration(session: Session, calibration_id: str | None) -> Calibration | None:
    if calibration_id is None:
        return None
    declared = calibrations.DECLARATION
    return read_asked(declared, found_asked(session, declared, calibration_id))


def _record_success(session: Session, kind: JobKind, subject_id: str, result: Contract, now: datetime) -> Recorded:
    """Write a result to the job's subject; the ledger gets a sentence about it and the next step, if any."""
    declared, stored = declaration_of(kind), result.model_dump(mode="json")
    if isinstance(declared, AskedKind):
        row = found_asked(session, declared, subject_id)
        row.result = stored
        why, step, activated = record_measurement(session, row, result, now), None, False
        if isinstance(row, CalibrationRow) and isinstance(result, CalibrationResult):
            # A calibration may have been asked to activate itself.
            reason = activation_reason(
                wanted=row.activate,
                schedule_id=row.schedule_id,
                rays_verdict=result.verdict_on_rays,
                has_moved=result.comparison is not None and not result.comparison.within_tolerance,
            )
            if reason is not None:
                job = row.job
                with acting_as(Actor(job.asked_by or THE_SERVICE.name, job.key_id, request_id=job.request_id)):
                    activate(session, row.scanner_id, row.id, reason, now)
            activated = reason is not None
            step = step_alone(result, active=activated)
        elif isinstance(result, DriftResult):
            step = step_of_check(result)
        return Recorded(why, {} if step is None else {"next_step": step.answer.model_dump(mode="json")})
    if kind is kinds.INGEST:
        scan = found(session, ScanRow, "scan", subject_id)
        scan.state, scan.reading = ScanState.READY, stored
        announce(session, now, mill_events.SCAN_READY, "scan", scan.id, group_id=scan.scanner_id)
    else:
        phantom = found(session, PhantomRow, "phantom", subject_id)
        phantom.state, phantom.drawing = PhantomState.READY, stored
        announce(session, now, mill_events.PHANTOM_READY, "phantom", phantom.id)
    return Recorded()


def _record_end_without_result(session: Session, kind: JobKind, subject_id: str, reason: str, now: datetime) -> None:
    """Refuse the scan or phantom whose job failed or was cancelled; other subjects have the state of their job."""
    if kind is kinds.INGEST:
        scan = found(session, ScanRow, "scan", subject_id)
        scan.state, scan.reason = ScanState.REFUSED, reason
        why = {"reason": reason}
        announce(session, now, mill_events.SCAN_REFUSED, "scan", scan.id, group_id=scan.scanner_id, detail=why)
    elif kind is kinds.TRACE_PHANTOM:
        phantom = found(session, PhantomRow, "phantom", subject_id)
        phantom.state, phantom.reason = PhantomState.REFUSED, reason
        announce(session, now, mill_events.PHANTOM_REFUSED, "phantom", phantom.id, detail={"reason": reason})


def _read_apart(path: Path) -> None:
    """Read a result of version 0.1.0 in a separate process; raise `DamagedResult` if it cannot be read."""
    try:
        read_apart(path)
    except UnreadableScan as error:
        raise DamagedResult(path.name, str(error)) from error


# Rows and files of a mill that jobs work on.
MILL_SUBJECTS = Subjects(
    NAMED_FOLDERS, handed_over, _record_success, _record_end_without_result, output_file, _read_apart
)
