"""Loading what an attempt is given: the worker has the database, the attempt's process has none."""

from typing import Any

from sawmill_worker.contracts.handed_over import HandedOver
from sawmill_worker.contracts.jobs import Job, JobKind
from sawmill_worker.contracts.kinds import AskedKind, declaration_of
from sawmill_worker.storage.files import SCAN_FILE
from sawmill_worker.storage.store import Store


def given_to(store: Store, job: Job) -> HandedOver:
    """What a job works on.

    Raises
    ------
    NotFound
        What it refers to was deleted since it was asked for, as a plan's phantom, which a plan does not keep.
    StorageUnavailable
        The database does not answer.
    """
    kept = store.files.kept_with(job.id)
    declared = declaration_of(job.kind)
    if isinstance(declared, AskedKind):
        return HandedOver(kept=kept, **_of_asked(store, declared, job.subject_id))
    file = store.files.upload(job.kind, job.subject_id)
    if job.kind is JobKind.TRACE_PHANTOM:
        return HandedOver(kept=kept, file=file, picture=store.phantoms.picture(job.subject_id))
    scan = store.scans.get(job.subject_id)
    return HandedOver(kept=kept, file=file, scan=scan, scanner=store.scanners.get(scan.scanner_id))


def _of_asked(store: Store, declared: AskedKind[Any, Any], subject_id: str) -> dict[str, Any]:
    """Fields of `HandedOver`, by the references that the row has."""
    asked = store.asked(declared).get(subject_id)
    fields: dict[str, Any] = {"asked_json": asked.model_dump_json()}
    if hasattr(asked, "scan_id"):
        fields["scan"] = store.scans.get(asked.scan_id)
        fields["file"] = store.files.results(JobKind.INGEST, asked.scan_id) / SCAN_FILE
    if hasattr(asked, "phantom_id"):
        fields["phantom"] = store.phantoms.get(asked.phantom_id)
    if declared.upload is not None:
        fields["file"] = store.files.upload(declared.kind, subject_id)
    if not hasattr(asked, "scanner_id"):
        return fields
    scanner = fields["scanner"] = store.scanners.get(asked.scanner_id)
    if not hasattr(asked, "calibration_id"):
        fields["active"] = _calibration(store, scanner.active_calibration_id)
    else:
        fields["calibration"] = _calibration(store, asked.calibration_id)
    return fields


def _calibration(store: Store, calibration_id: str | None) -> Any:  # noqa: ANN401 - one of two contracts
    return None if calibration_id is None else store.calibrations.get(calibration_id)
