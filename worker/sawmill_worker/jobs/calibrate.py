"""The job that calibrates a scanner with one scan."""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.calibration.calibrate import CalibrationInput, calibration_result, run_calibration
from sawmill_calibration.calibration.calibration_files import calibration_arrays, write_result
from sawmill_calibration.calibration.compare import compared, geometry_of
from sawmill_calibration.calibration.log_comparison import find_log_row, log_images
from sawmill_calibration.calibration.second_witness import with_second_witness, witness_of
from sawmill_calibration.failures import refused
from sawmill_calibration.reconstruction.reconstruct import volume_unit
from sawmill_calibration.scans.prepare import Stack, repeated
from sawmill_calibration.scans.selection import chosen_rows, chosen_views
from sawmill_contracts.calibrations import (
    CalibrationLimits,
    CalibrationOptions,
    CalibrationSucceeded,
    CalibrationUnfinished,
)
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.scans import Scan, ScanShape, ScanState
from sawmill_formats.output.scan_reader import read_stored_scan
from sawmill_platform.attempts.work import Needs
from sawmill_tomography.sinograms.present_rows import mean_of_rows
from sawmill_vocabulary import DataKind, DetectorModule
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.jobs.checkpoints import AttemptKeeper
from sawmill_worker.jobs.needs import of_averaged_rows


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Write result.h5, from which the pictures are drawn, and return the full result."""
    request, scanner = attempt.asked(CalibrationUnfinished), attempt.scanner
    options = request.options.model_copy(
        update={
            "handedness": request.options.handedness or scanner.handedness,
            "rotation": request.options.rotation or scanner.rotation,
        }
    )
    scan = usable_scan(attempt)
    attempt.report_stage(0.0, "read")
    calibration_input, stack, rows_named = _load(attempt, scan, options)
    keeper = _keeper(attempt, calibration_input, options)
    calibration_input, calibration = run_calibration(
        calibration_input, options, attempt.report, stack=stack, rows_named=rows_named, keeper=keeper
    )
    usable = scan.usable_rows or (0, shape_of(scan).rows)
    attempt.report_stage(0.96, "log")
    read = _row_reader(attempt, scan, options)
    calibration_input, calibration = with_second_witness(
        calibration, calibration_input, row_range=options.log_rows, rows=usable, read=read
    )
    active = _active(attempt)
    comparison = None if active is None else compared(active, calibration.geometry, scanner)
    attempt.report_stage(0.97, "result")
    log = find_log_row(calibration_input, usable, read)
    before = None if active is None else geometry_of(active)
    images = None if log is None else log_images(log, calibration_input, calibration.geometry, before)
    result = calibration_result(calibration, calibration_input, comparison, witness_of(calibration, calibration_input))
    kept = calibration_arrays(calibration, calibration_input, images)
    write_result(attempt.output, result, kept, log_unit=volume_unit(counts=calibration_input.from_counts))
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


def _load(attempt: MillAttempt, scan: Scan, options: CalibrationOptions) -> tuple[CalibrationInput, Stack, bool]:
    """Load the input, the stack of its rows, and whether somebody named the rows that show the phantom."""
    shape, scanner = shape_of(scan), attempt.scanner
    rows = chosen_rows(options.rows or scan.phantom_rows, shape.rows, scan.usable_rows)
    views = chosen_views(options.views, shape.views, scan.views_left_out)
    stored = read_stored_scan(attempt.file, rows, views)
    mean = mean_of_rows(stored.line_integrals)
    active = _active(attempt)
    calibrated = None if active is None else active.scanner
    modules = known_modules(scanner.constants, stored.detector_modules, calibrated)
    calibration_input = CalibrationInput(
        sinogram=mean.sinogram,
        angles_rad=stored.angles_rad[mean.views],
        rows=(rows.start, rows.stop),
        scanner=replace(scanner.constants, detector_modules=modules),
        bounds=scanner.bounds,
        drawing=drawing_of(attempt),
        input_sha256=scan.sha256,
        limits=CalibrationLimits.of(scanner.tolerances, scanner.log_radius_mm),
        from_counts=scan.data is DataKind.COUNTS,
        views=mean.views,
        remarks=repeated(scan.reasons),
        saturated_share=stored.saturated_share,
    )
    named = options.rows is not None or scan.phantom_rows is not None
    return calibration_input, stored.line_integrals, named


def _keeper(attempt: MillAttempt, calibration_input: CalibrationInput, options: CalibrationOptions) -> AttemptKeeper:
    origin = {
        "input_sha256": calibration_input.input_sha256,
        "options": options.model_dump(mode="json"),
        "rows": calibration_input.rows,
        "scanner": asdict(calibration_input.scanner),
        "bounds": None if calibration_input.bounds is None else asdict(calibration_input.bounds),
        "phantom": calibration_input.drawing.model_dump(mode="json"),
    }
    return AttemptKeeper(attempt, origin)


def declared_modules(constants: ScannerConstants, of_scan: tuple[DetectorModule, ...]) -> tuple[DetectorModule, ...]:
    """Return the modules that somebody declared: the scanner's; if it has none, the ones in the scan's file."""
    return constants.detector_modules or of_scan


def known_modules(
    present: ScannerConstants, of_scan: tuple[DetectorModule, ...], calibrated: ScannerConstants | None
) -> tuple[DetectorModule, ...]:
    """Return the modules from which a calibration starts: those of the active one, if its detector is still there."""
    if calibrated is None or replace(calibrated, detector_modules=present.detector_modules) != present:
        return declared_modules(present, of_scan)
    return calibrated.detector_modules


def _active(attempt: MillAttempt) -> CalibrationSucceeded | None:
    active = attempt.given.active
    return active if isinstance(active, CalibrationSucceeded) else None


def _row_reader(attempt: MillAttempt, scan: Scan, options: CalibrationOptions) -> Callable[[int], NDArray[np.float32]]:
    """Return a function that reads any row of the scan, (views, detector); NaN in views that lack the row."""
    views = chosen_views(options.views, shape_of(scan).views, scan.views_left_out)

    def read(row: int) -> NDArray[np.float32]:
        return read_stored_scan(attempt.file, slice(row, row + 1), views).line_integrals[:, 0]

    return read
