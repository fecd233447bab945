"""The job that checks a scan for drift since a calibration."""

from typing import Any

from sawmill_calibration.drift_checks.drift_check import check_drift
from sawmill_calibration.known_geometry import GivenGeometry, check_same_scanner
from sawmill_contracts.drifts import Drift
from sawmill_formats.output.scan_reader import open_scan
from sawmill_platform.attempts.protocol import Needs
from sawmill_vocabulary import Rotation
from sawmill_worker.jobs.attempt import MillAttempt, of_averaged_rows
from sawmill_worker.jobs.calibrate import shape_of, stored_rows, usable_calibration, usable_scan


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Return what moved since the calibration; no files are written."""
    scanner, options = attempt.scanner, attempt.asked(Drift).options
    theta, rotation = options.theta, options.rotation or Rotation.AS_GIVEN
    imported = None if theta is None else GivenGeometry(scanner.constants, theta, rotation)
    calibration = imported or usable_calibration(attempt, "compare with")
    # The source's distance may have been measured again: it does not move the detector.
    check_same_scanner(calibration.scanner, scanner.constants, ("num_detector_pixels", "detector_pitch_mm"))
    attempt.report_stage(0.1, "read")
    with open_scan(attempt.file) as stored:
        result = check_drift(
            stored_rows(attempt, stored, options.rows, None),
            calibration,
            log_radius_mm=scanner.log_radius_mm,
            tolerance_mm=scanner.tolerances.ray_change_mm,
            tolerance_scale_percent=scanner.tolerances.scale_percent,
            baselines=attempt.given.baselines,
        )
    return result.model_dump(mode="json")


def needs(attempt: MillAttempt) -> Needs:
    """Compute the needs of averaging the rows."""
    scan = usable_scan(attempt)
    return of_averaged_rows(shape_of(scan), attempt.asked(Drift).options.rows, scan.usable_rows)
