"""The job that calibrates a scanner with one scan."""

from dataclasses import asdict, replace
from typing import Any

from sawmill_calibration.calibration.calibrate_scan import calibrate_scan, compared, geometry_of
from sawmill_calibration.calibration.calibration_files import write_result
from sawmill_calibration.failures import refused
from sawmill_calibration.reconstruction.reconstruct import volume_unit
from sawmill_calibration.scans.scan_rows import ScanRows, rows_of
from sawmill_contracts.calibrations import CalibrationLimits, CalibrationSucceeded, CalibrationUnfinished
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.scans import Scan, ScanShape, ScanState
from sawmill_formats.output.scan_reader import OpenScan, open_scan
from sawmill_platform.attempts.protocol import Needs
from sawmill_vocabulary import DataKind
from sawmill_worker.jobs.attempt import MillAttempt, of_averaged_rows
from sawmill_worker.jobs.checkpoints import AttemptKeeper


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Write result.h5, from which the pictures are drawn, and return the full result."""
    request, scanner, scan = attempt.asked(CalibrationUnfinished), attempt.scanner, usable_scan(attempt)
    options = request.options.model_copy(
        update={
            "handedness": request.options.handedness or scanner.handedness,
            "rotation": request.options.rotation or scanner.rotation,
        }
    )
    active = attempt.given.active if isinstance(attempt.given.active, CalibrationSucceeded) else None
    attempt.report_stage(0.0, "read")
    with open_scan(attempt.file) as stored:
        rows = stored_rows(attempt, stored, options.rows or scan.phantom_rows, options.views)
        calibrated = None if active is None else active.scanner
        rows = replace(rows, scanner=known_cells(scanner.constants, stored, calibrated))
        drawing = drawing_of(attempt)
        origin = {
            "input_sha256": scan.sha256,
            "options": options.model_dump(mode="json"),
            "rows": rows.rows,
            "scanner": asdict(rows.scanner),
            "bounds": None if scanner.bounds is None else asdict(scanner.bounds),
            "phantom": drawing.model_dump(mode="json"),
        }
        limits = CalibrationLimits.of(scanner.tolerances, scanner.log_radius_mm)
        keeper = AttemptKeeper(attempt, origin)
        made = calibrate_scan(rows, drawing, options, limits, bounds=scanner.bounds, keeper=keeper)
        attempt.report_stage(0.97, "result")
        result = made.result(None if active is None else compared(active, made.outcome.geometry, scanner))
        arrays = made.arrays(None if active is None else geometry_of(active))
    write_result(attempt.output, result, arrays, log_unit=volume_unit(counts=rows.counts))
    return result.model_dump(mode="json")


def needs(attempt: MillAttempt) -> Needs:
    """Compute the needs of averaging the rows."""
    scan, options = usable_scan(attempt), attempt.asked(CalibrationUnfinished).options
    return of_averaged_rows(shape_of(scan), options.rows or scan.phantom_rows, scan.usable_rows)


def usable_scan(attempt: MillAttempt) -> Scan:
    """Return the scan, which must be ready; the job that reads a scan may have refused it since the request."""
    scan = attempt.given.scan
    assert scan is not None  # noqa: S101 - required by this kind of job
    if scan.state is not ScanState.READY or scan.shape is None:
        raise refused("scan-refused", f"scan {scan.id!r} cannot be used: {scan.reason or scan.state.value}")
    return scan


def shape_of(scan: Scan) -> ScanShape:
    """Return the shape of a usable scan."""
    assert scan.shape is not None  # noqa: S101 - checked by usable_scan
    return scan.shape


def usable_calibration(attempt: MillAttempt, purpose: str) -> CalibrationSucceeded:
    """Return the calibration, which must have succeeded; a refusal's sentence ends with the geometry's purpose."""
    calibration = attempt.given.calibration
    assert calibration is not None  # noqa: S101 - required by this request
    if not isinstance(calibration, CalibrationSucceeded):
        raise refused(
            "calibration-without-result",
            f"calibration {calibration.id!r} is {calibration.state} and has no geometry to {purpose}",
        )
    return calibration


def drawing_of(attempt: MillAttempt) -> PhantomDrawing:
    """Return the phantom's drawing; the job that traces a picture may have refused it since the request."""
    phantom = attempt.given.phantom
    assert phantom is not None  # noqa: S101 - required by this kind of job
    if phantom.drawing is None:
        raise refused("phantom-refused", f"phantom {phantom.id!r} has no drawing: {phantom.reason}")
    return phantom.drawing


def stored_rows(attempt: MillAttempt, stored: OpenScan, rows: str | None, views: int | None) -> ScanRows:
    """Select rows and views of the attempt's scan; the scanner has the modules that somebody declared."""
    scan, constants = usable_scan(attempt), attempt.scanner.constants
    return rows_of(
        stored,
        declared_cells(constants, stored),
        rows=rows,
        views=views,
        counts=scan.data is DataKind.COUNTS,
        sha256=scan.sha256,
        remarks=scan.reasons,
        averaged_rows=scan.averaged_rows,
        on_progress=attempt.report,
    )


def declared_cells(constants: ScannerConstants, of_scan: OpenScan) -> ScannerConstants:
    """Return the scanner with the modules and the arc that it declares; if it has none, the ones in the scan's file."""
    modules = constants.detector_modules or of_scan.detector_modules
    radius_mm = constants.detector_arc_radius_mm or of_scan.detector_arc_radius_mm
    return replace(constants, detector_modules=modules, detector_arc_radius_mm=radius_mm)


def known_cells(present: ScannerConstants, of_scan: OpenScan, calibrated: ScannerConstants | None) -> ScannerConstants:
    """Return the scanner with the places of cells from which a calibration starts.

    The active calibration has them, if the detector is still there.
    """
    if calibrated is not None and calibrated.with_cells_of(present) == present:
        return present.with_cells_of(calibrated)
    return declared_cells(present, of_scan)
