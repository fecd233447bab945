"""What a job has left behind: a scan's shape, a reconstruction's result; where there is none yet, why."""

from sawmill_service.problems import Refused
from sawmill_worker.contracts.reconstructions import ReconstructionResult
from sawmill_worker.contracts.scans import Scan, ScanShape
from sawmill_worker.storage.store import Store


def result_of(store: Store, reconstruction_id: str) -> ReconstructionResult:
    """A reconstruction's result.

    Raises
    ------
    Refused
        409 `reconstruction-without-result`.
    """
    reconstruction = store.reconstructions.get(reconstruction_id)
    if reconstruction.result is None:
        detail = f"reconstruction {reconstruction_id!r} is {reconstruction.state} and has no volume"
        raise Refused(409, "reconstruction-without-result", detail)
    return reconstruction.result


def ready_scan(store: Store, scan_id: str) -> tuple[Scan, ScanShape]:
    """A scan that has been read.

    Raises
    ------
    Refused
        409 `scan-ingesting` or `scan-refused`.
    """
    scan = store.scans.get(scan_id)
    if scan.shape is None:
        reason = scan.reason or f"job {scan.job_id} still reads it"
        raise Refused(409, f"scan-{scan.state}", f"scan {scan_id!r} is {scan.state}: {reason}")
    return scan, scan.shape


def middle_row(scan: Scan, shape: ScanShape) -> int:
    """Of the rows that enough views have."""
    first, last = scan.usable_rows or (0, shape.rows)
    return (first + last) // 2
