"""Results of jobs: a scan's shape, a reconstruction's result; where there is none yet, the reason."""

from sawmill_contracts.reconstructions import ReconstructionResult
from sawmill_contracts.scans import Scan, ScanShape
from sawmill_platform.errors import NotFound
from sawmill_service.http.problems import Refused
from sawmill_store.reconstructions import Reconstructions
from sawmill_store.scans import Scans


def result_of(reconstructions: Reconstructions, reconstruction_id: str) -> ReconstructionResult:
    """Return the result of a reconstruction."""
    reconstruction = reconstructions.get(reconstruction_id)
    if reconstruction.result is None:
        detail = f"reconstruction {reconstruction_id!r} is {reconstruction.state} and has no volume"
        raise Refused(409, "reconstruction-without-result", detail)
    return reconstruction.result


def check_slice(result: ReconstructionResult, index: int) -> None:
    """Refuse the index of a slice that a volume does not have."""
    slices = result.shape[0]
    if index >= slices:
        raise Refused(404, "slice-not-found", f"index must be below {slices}, the slices, not {index}")


def scan_if_kept(scans: Scans, scan_id: str) -> Scan | None:
    """Return a scan from which something was made; None where the scan was deleted since."""
    try:
        return scans.get(scan_id)
    except NotFound:
        return None


def ready_scan(scans: Scans, scan_id: str) -> tuple[Scan, ScanShape]:
    """Return a scan that has been read, and its shape."""
    scan = scans.get(scan_id)
    if scan.shape is None:
        reason = scan.reason or f"job {scan.job_id} still reads it"
        raise Refused(409, f"scan-{scan.state}", f"scan {scan_id!r} is {scan.state}: {reason}")
    return scan, scan.shape


def middle_row(scan: Scan, shape: ScanShape) -> int:
    """Return the middle of the rows that enough views have."""
    first, last = scan.usable_rows or (0, shape.rows)
    return (first + last) // 2
