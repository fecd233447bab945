"""The job that checks a scan for drift since a calibration."""

from typing import Any

from sawmill_calibration.drift_checks.drift_check import (
    DriftInput,
    mean_of_common_rows,
    run_drift,
)
from sawmill_calibration.failures import refused
from sawmill_calibration.scans.selection import chosen_rows, chosen_views
from sawmill_contracts.drifts import Drift
from sawmill_formats.output.scan_reader import read_stored_scan
from sawmill_platform.attempts.work import Needs
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.jobs.calibrate import shape_of, usable_calibration, usable_scan
from sawmill_worker.jobs.needs import of_averaged_rows


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Return what moved since the calibration; no files are written."""
    request, scanner = attempt.asked(Drift), attempt.scanner
    calibration = usable_calibration(attempt, "compare with")
    scan = usable_scan(attempt)
    shape = shape_of(scan)
    calibrated, present = calibration.scanner, scanner.constants
    if (calibrated.num_detector_pixels, calibrated.detector_pitch_mm) != (shape.detector, present.detector_pitch_mm):
        raise refused(
            "contradiction",
            f"the calibration is of {calibrated.num_detector_pixels} cells of {calibrated.detector_pitch_mm:.9g} mm "
            f"and the scan of {shape.detector} of {present.detector_pitch_mm:.9g} mm: "
            "calibrate the scanner as it is now",
        )
    if scan.averaged_rows is not None and request.options.rows is not None:
        raise refused(
            "rows-outside",
            f"rows {request.options.rows} were asked for, but the scan is the mean of {scan.averaged_rows} rows, which "
            "are not kept: leave rows out",
        )
    rows = chosen_rows(request.options.rows, shape.rows, scan.usable_rows)
    attempt.report_stage(0.1, "read")
    stored = read_stored_scan(attempt.file, rows, chosen_views(None, shape.views, scan.views_left_out))
    attempt.report_stage(0.5, "pair rays")
    drift_input = DriftInput(
        mean=mean_of_common_rows(stored.line_integrals, rows.start, deviations=stored.deviations),
        angles_rad=stored.angles_rad,
        rows=(rows.start, rows.stop),
        calibration=calibration,
        input_sha256=scan.sha256,
        log_radius_mm=scanner.log_radius_mm,
        tolerance_mm=scanner.tolerances.ray_change_mm,
        tolerance_scale_percent=scanner.tolerances.scale_percent,
        averaged_rows=scan.averaged_rows,
        preparation=scan.reasons,
        baselines=attempt.given.baselines,
    )
    return run_drift(drift_input).model_dump(mode="json")


def needs(attempt: MillAttempt) -> Needs:
    """Compute the needs of averaging the rows."""
    scan = usable_scan(attempt)
    return of_averaged_rows(shape_of(scan), attempt.asked(Drift).options.rows, scan.usable_rows)
