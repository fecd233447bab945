"""The job that plans a calibration of a scanner with a phantom."""

from typing import Any

from sawmill_calibration.calibration.plan import run_plan
from sawmill_contracts.plans import Plan
from sawmill_platform.attempts.protocol import Needs
from sawmill_worker.jobs.attempt import PROCESS_BYTES, SINOGRAMS, MillAttempt
from sawmill_worker.jobs.calibrate import drawing_of


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Return the precision to expect; no files are written."""
    scanner, options = attempt.scanner, attempt.asked(Plan).options
    assert options.theta is not None  # noqa: S101 - set when the job was accepted
    planned = run_plan(drawing_of(attempt), scanner.constants, options.theta, options, scanner.log_radius_mm)
    return planned.model_dump(mode="json")


def needs(attempt: MillAttempt) -> Needs:
    """Compute the needs of the phantom's sinogram."""
    cells = attempt.scanner.constants.num_detector_pixels
    return Needs(PROCESS_BYTES + SINOGRAMS * 8 * attempt.asked(Plan).options.views * cells, 0)
