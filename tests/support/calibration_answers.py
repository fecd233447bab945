"""A calibration's file with an answer alone."""

from pathlib import Path

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_formats.output.calibration_file import write_calibration


def write_answer(path: Path, result: CalibrationResult) -> None:
    """As the service's result.h5, without arrays."""
    about = result.model_dump(include={"software_version", "input_sha256"})
    write_calibration(path, result.model_dump(mode="json"), {}, **about)
