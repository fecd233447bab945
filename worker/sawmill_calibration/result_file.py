"""A calibration's answer in a file: RESULT.json from `calibrate --json` or from the service, or result.h5."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import h5py
from pydantic import ValidationError

from sawmill_calibration.failures import refused
from sawmill_contracts.calibrations import CalibrationFile, CalibrationResult
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input import own
from sawmill_formats.reading_apart import read_apart
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.base import placed_complaint
from sawmill_vocabulary.calibration_arrays import CalibrationArrays


@dataclass(frozen=True)
class SavedCalibration:
    """Answer of a file, the arrays and the time if it has them, and additional fields of the service's JSON."""

    result: CalibrationResult
    arrays: CalibrationArrays | None
    made_at: datetime | None
    header: dict[str, Any]


def read_calibration(path: Path) -> CalibrationResult:
    """Read the calibration in a file, whose format is recognised by the content; refuse a file that holds none."""
    with _refusing(path):
        if h5py.is_hdf5(path):
            read_apart(path)
            return CalibrationResult.model_validate_json(own.read_calibration_json(path))
        return CalibrationFile.read(_text(path))


def read_saved_calibration(path: Path) -> SavedCalibration:
    """Read the calibration in a file with all other data; refuse arrays that are damaged or do not agree."""
    result = read_calibration(path)
    with _refusing(path):
        if h5py.is_hdf5(path):
            arrays = own.read_calibration_arrays(path)
            read = None if arrays is None else CalibrationArrays.of(arrays)
            return SavedCalibration(result, read, _time(own.read_time_of_writing(path)), {})
        document = json.loads(_text(path))
        header = {name: value for name, value in document.items() if name not in CalibrationResult.model_fields}
        return SavedCalibration(result, None, _time(header.get("created_at")), header)


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    try:
        yield
    except ValidationError as error:
        raise _refused(path, placed_complaint(error)) from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise _refused(path, "it is neither JSON nor HDF5") from error
    except (UnreadableScan, ValueError) as error:
        raise _refused(path, str(error)) from error


def _time(text: object) -> datetime | None:
    """Parse a time with its zone; return None for any other text."""
    try:
        time = datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return None if time.tzinfo is None else time


def _text(path: Path) -> str:
    with path.open("rb") as stream:
        content = stream.read(own.LONGEST_ANSWER + 1)
    if len(content) > own.LONGEST_ANSWER:
        raise ValueError(f"it has more than {own.LONGEST_ANSWER} bytes")
    return content.decode("utf-8")


def _refused(path: Path, reason: str) -> JobFailure:
    return refused(
        "calibration", f"{path.name} is neither what calibrate --json prints nor a calibration's result.h5: {reason}"
    )
