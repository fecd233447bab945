"""Input of a job, read from the rows: the worker has the database, and the process of the attempt has none."""

from typing import Any

from sqlalchemy.orm import Session

from sawmill_contracts import calibrations, job_kinds
from sawmill_contracts.calibrations import Calibration
from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.kinds import AskedKind
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.database.paging import found
from sawmill_platform.database.tables import JobRow
from sawmill_platform.files.file_store import FileStore
from sawmill_store.drift_charts import known_baselines
from sawmill_store.mill_files import SCAN_FILE
from sawmill_store.mill_tables import PhantomRow, ScannerRow, ScanRow
from sawmill_store.phantoms import picture_of, read_phantom
from sawmill_store.requests.asked_rows import found_asked, read_asked
from sawmill_store.scanners import read_scanner
from sawmill_store.scans import read_scan


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
    if job.kind is job_kinds.TRACE_PHANTOM:
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
            fields["file"] = files.results(job_kinds.INGEST, scan.id) / SCAN_FILE
    if hasattr(answer, "phantom_id"):
        fields["phantom"] = read_phantom(found(session, PhantomRow, "phantom", answer.phantom_id))
    if declared.upload is not None:
        fields["file"] = files.upload(declared.kind, subject_id)
    if not hasattr(answer, "scanner_id"):
        return fields
    scanner = read_scanner(session, found(session, ScannerRow, "scanner", answer.scanner_id))
    fields["scanner"] = scanner
    if hasattr(answer, "calibration_id"):
        fields["calibration"] = _calibration(session, answer.calibration_id)
        if declared.kind is job_kinds.DRIFT:
            fields["baselines"] = known_baselines(session, answer.scanner_id, answer.calibration_id)
    elif hasattr(answer, "scan_id"):
        fields["active"] = _calibration(session, scanner.active_calibration_id)
    return fields


def _calibration(session: Session, calibration_id: str | None) -> Calibration | None:
    if calibration_id is None:
        return None
    declared = calibrations.DECLARATION
    return read_asked(declared, found_asked(session, declared, calibration_id))
