"""Look for drift in one of a scanner's scans."""

from typing import Any

import numpy as np

from sawmill_worker.contracts.calibrations import CalibrationSucceeded
from sawmill_worker.files.scan_reader import read_stored_scan
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.calibrate import usable_scan
from sawmill_worker.use_cases.drift import DriftInput, run_drift
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.use_cases.selection import chosen_rows, chosen_views


def drift(attempt: Attempt) -> dict[str, Any]:
    """Answer with what moved since the calibration; there are no files."""
    store = attempt.store
    asked = store.drifts.get(attempt.job.subject_id)
    calibration = store.calibrations.get(asked.calibration_id)
    if not isinstance(calibration, CalibrationSucceeded):
        raise refused(
            "calibration-without-result",
            f"calibration {asked.calibration_id!r} is {calibration.state} and has no geometry to compare with",
        )
    scanner = store.scanners.get(asked.scanner_id)
    scan = usable_scan(store, asked.scan_id)
    assert scan.shape is not None  # noqa: S101 - usable_scan saw to it
    known, now = calibration.scanner, scanner.constants
    if (known.num_detector_pixels, known.detector_pitch_mm) != (scan.shape.detector, now.detector_pitch_mm):
        raise refused(
            "contradiction",
            f"the calibration is of {known.num_detector_pixels} cells of {known.detector_pitch_mm:.9g} mm "
            f"and the scan of {scan.shape.detector} of {now.detector_pitch_mm:.9g} mm: "
            "calibrate the scanner as it is now",
        )
    rows = chosen_rows(asked.options.rows, scan.shape.rows)
    attempt.say(0.1, "read")
    stored = read_stored_scan(store.files.scan(scan.id), rows, chosen_views(None, scan.shape.views))
    attempt.say(0.5, "pair rays")
    given = DriftInput(
        sinogram=stored.line_integrals.mean(axis=1, dtype=np.float64),
        angles_rad=stored.angles_rad,
        rows=(rows.start, rows.stop),
        calibration=calibration,
        input_sha256=scan.sha256,
        log_radius_mm=scanner.log_radius_mm,
        tolerance_mm=scanner.tolerances.ray_change_mm,
    )
    return run_drift(given).model_dump(mode="json")
