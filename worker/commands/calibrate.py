"""`sawmill calibrate`: a scan's file to a calibration."""

from pathlib import Path

import numpy as np

from worker.commands.options import PhantomSaid, ScanSaid
from worker.commands.phantoms import drawing_of
from worker.commands.scan_input import load
from worker.commands.terminal import Report
from worker.contracts.calibrations import CalibrationOptions, CalibrationResult
from worker.contracts.jobs import Progress
from worker.tasks.calibrating import CalibrationInput, run_calibration, with_phantom_rows


def calibrate_scan(
    said: ScanSaid,
    phantom: PhantomSaid,
    options: CalibrationOptions,
    *,
    source_to_cor_mm: float,
    picture: Path | None,
    report: Report,
) -> CalibrationResult:
    """Read, calibrate, and draw the report where one is asked for."""
    drawing = drawing_of(phantom)
    report(Progress(fraction=0.0, stage="read"))
    used = load(said, source_to_cor_mm=source_to_cor_mm)
    given = CalibrationInput(
        sinogram=used.stack.mean(axis=1, dtype=np.float64),
        angles_rad=used.angles_rad,
        rows=used.rows,
        scanner=used.scanner,
        bounds=None,
        drawing=drawing,
        input_sha256=used.sha256,
        from_counts=used.counts,
    )
    if said.rows is None:
        given = with_phantom_rows(given, used.stack)
    calibration, result = run_calibration(given, options, report)
    if picture is not None:
        # Drawing takes longer to import than a calibration takes.
        from worker.tasks.calibration_files import write_report_png  # noqa: PLC0415

        write_report_png(picture, calibration, result, given)
    return result
