"""A calibration's file: its answer as JSON text and as groups, and the arrays behind it."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from sawmill_formats.hdf5 import whole_hdf5
from sawmill_formats.nexus import new_entry, new_group, write_mapping, write_process, write_scalar
from sawmill_formats.output.own_hdf5 import check_members, dataset_at, group_at, needed, reading_own, values_of

# The answer as JSON text, the same as groups, and the arrays.
ANSWER = "entry/calibration_json"
GROUPS = "calibration"
ARRAYS = "entry/arrays"


class NamedArray(NamedTuple):
    """An array or a single number with its unit, and its axes in words, as in `view, detector`."""

    values: NDArray[Any]
    unit: str
    axes: str


@dataclass(frozen=True)
class CalibrationRecord:
    """A calibration's answer, as JSON has it, and the arrays behind the answer by name."""

    answer: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def write_calibration(
    path: Path, result: Mapping[str, Any], arrays: Mapping[str, NamedArray], *, software_version: str, input_sha256: str
) -> None:
    """Write a calibration: its answer as JSON text and as groups, and the arrays behind it.

    Parameters
    ----------
    result : mapping
        JSON-able and nested, the units in the names.
    arrays : mapping of name to NamedArray
        Written as they are: a third smaller when packed, and packing them takes longer than writing them.
    software_version, input_sha256 : str
        Version of the program that made the calibration, and checksum of the scan.

    Raises
    ------
    OSError
        When the file cannot be written.
    """
    text = json.dumps(result, allow_nan=False)
    with whole_hdf5(path) as file:
        entry = new_entry(file)
        write_process(entry, "process", software_version, input_sha256)
        file[ANSWER] = text
        write_mapping(entry, GROUPS, result)
        group = new_group(file, ARRAYS, "NXcollection")
        for name, (values, unit, axes) in arrays.items():
            write_scalar(group, name, values, unit)
            group[name].attrs["axes_description"] = axes


def check_calibration(path: Path, sinogram: tuple[int, int]) -> None:
    """Check that result.h5 holds a calibration of such a sinogram (views, detector), and nothing that leads elsewhere.

    Raises
    ------
    DamagedResult
        It does not; also raised by the functions that read the file.
    """
    with reading_own(path) as file:
        # The sinogram, its model and the residual.
        check_members(file, path, 3 * 8 * math.prod(sinogram))
        for name in ("sinogram", "model", "residual"):
            needed(dataset_at(file, f"{ARRAYS}/{name}", sinogram), name)
        needed(dataset_at(file, ANSWER), ANSWER)


def read_arrays(path: Path, *names: str) -> dict[str, NDArray[Any]]:
    """Read the named arrays of result.h5 that it holds."""
    with reading_own(path) as file:
        return {name: values_of(file, f"{ARRAYS}/{name}") for name in names if dataset_at(file, f"{ARRAYS}/{name}")}


def read_calibration(path: Path) -> CalibrationRecord:
    """Read result.h5 of a calibration."""
    with reading_own(path) as file:
        arrays = {name: values_of(file, f"{ARRAYS}/{name}") for name in group_at(file, ARRAYS) or ()}
        return CalibrationRecord(answer=json.loads(values_of(file, ANSWER).item()), arrays=arrays)
