"""A calibration's answer in a file: RESULT.json as `calibrate --json` or the service gave it, or its result.h5."""

import json
from pathlib import Path

import h5py
from pydantic import ValidationError

from sawmill_worker.contracts.base import placed_complaint
from sawmill_worker.contracts.calibrations import CalibrationFile, CalibrationResult
from sawmill_worker.files.errors import UnreadableScan
from sawmill_worker.readers.calibration_answer import LONGEST_ANSWER, read_calibration_json
from sawmill_worker.use_cases.failures import JobFailure, refused


def read_calibration(path: Path) -> CalibrationResult:
    """The calibration in a file, which is recognised by its content and never by its name.

    Raises
    ------
    JobFailure
        It holds none.
    """
    try:
        if h5py.is_hdf5(path):
            return CalibrationResult.model_validate_json(read_calibration_json(path))
        return CalibrationFile.read(_text(path))
    except ValidationError as error:
        raise _refused(path, placed_complaint(error)) from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise _refused(path, "it is neither JSON nor HDF5") from error
    except (UnreadableScan, ValueError) as error:
        raise _refused(path, str(error)) from error


def _text(path: Path) -> str:
    with path.open("rb") as stream:
        content = stream.read(LONGEST_ANSWER + 1)
    if len(content) > LONGEST_ANSWER:
        raise ValueError(f"it has more than {LONGEST_ANSWER} bytes")
    return content.decode("utf-8")


def _refused(path: Path, reason: str) -> JobFailure:
    return refused(
        "calibration",
        f"{path.name} is neither what calibrate --json prints nor a calibration's result.h5: {reason}",
    )
