"""`sawmill calibrate`: calibration from a scan's file."""

from datetime import datetime
from pathlib import Path

from sawmill_calibration.calibration.calibrate import CalibrationInput, calibration_result, run_calibration
from sawmill_calibration.calibration.second_witness import with_second_witness, witness_of
from sawmill_calibration.scans.prepare import repeated
from sawmill_calibration.scans.scan_rows import open_rows
from sawmill_calibration.scans.scan_source import ScanSource
from sawmill_contracts.calibrations import CalibrationLimits, CalibrationOptions, CalibrationResult
from sawmill_tomography.sinograms.present_rows import mean_of_rows
from sawmill_vocabulary import ProgressCallback
from sawmill_worker.commands.phantom_options import PhantomSource
from sawmill_worker.commands.phantoms import drawing_of


def calibrate_scan(
    scan: ScanSource,
    phantom: PhantomSource,
    options: CalibrationOptions,
    *,
    source_to_cor_mm: float,
    scale_tolerance_percent: float,
    log_radius_mm: float | None,
    picture: Path | None,
    on_progress: ProgressCallback,
) -> CalibrationResult:
    """Read, calibrate, and draw the report if a path for it is given."""
    drawing = drawing_of(phantom)
    with open_rows(scan, source_to_cor_mm=source_to_cor_mm, on_progress=on_progress) as used:
        stack = used.stack()
        mean = mean_of_rows(stack)
        calibration_input = CalibrationInput(
            sinogram=mean.sinogram,
            angles_rad=used.angles_rad[mean.views],
            rows=used.rows,
            scanner=used.scanner,
            bounds=None,
            drawing=drawing,
            input_sha256=used.sha256,
            limits=CalibrationLimits(scale_tolerance_percent=scale_tolerance_percent, log_radius_mm=log_radius_mm),
            from_counts=used.counts,
            views=mean.views,
            remarks=repeated(used.remarks),
            saturated_share=used.saturated_share,
        )
        named = scan.rows is not None
        calibration_input, calibration = run_calibration(
            calibration_input, options, used.on_progress, stack=stack, rows_named=named
        )
        calibration_input, calibration = with_second_witness(
            calibration, calibration_input, row_range=options.log_rows, rows=used.usable_rows, read=used.read_row
        )
    result = calibration_result(calibration, calibration_input, witness=witness_of(calibration, calibration_input))
    if picture is not None:
        # Imported here because the module imports the reconstruction, which an answer without a report does not need.
        from sawmill_calibration.calibration.calibration_files import report_arrays, write_report  # noqa: PLC0415
        from sawmill_worker.pictures.report_page import About  # noqa: PLC0415

        name = scan.path.name
        about = About(made_at=datetime.now().astimezone(), scan_name=name, phantom=drawing, origin=name)
        write_report(picture, result, report_arrays(calibration, calibration_input, stack, used.rows), about)
    return result
