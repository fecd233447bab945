"""RESULT.json: what `sawmill calibrate --json` printed, or the service answered."""

from pathlib import Path

from worker.contracts.calibrations import CalibrationFile, CalibrationResult
from worker.tasks.failures import refused


def read_calibration(path: Path) -> CalibrationResult:
    """The calibration in a file.

    Raises
    ------
    JobFailure
        It holds none.
    """
    try:
        return CalibrationFile.read(path.read_text(encoding="utf-8"))
    except ValueError as error:  # JSON, text encoding and contract alike
        reason = str(error).splitlines()[0]
        raise refused("calibration", f"{path.name} is not what calibrate --json prints: {reason}") from error
