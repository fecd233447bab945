"""A calibration's file: its answer as JSON text and as groups, and the arrays behind it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.files.hdf5 import open_hdf5, whole_hdf5
from sawmill_worker.files.nexus import new_entry, new_group, write_mapping, write_process, write_scalar

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
    """A calibration's answer, as JSON has it, and the arrays behind it by name."""

    answer: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def write_calibration(
    path: Path,
    result: Mapping[str, Any],
    arrays: Mapping[str, NamedArray],
    *,
    software_version: str,
    input_sha256: str,
) -> None:
    """Write a calibration: its answer as JSON text and as groups, and the arrays behind it.

    Parameters
    ----------
    result : mapping
        JSON-able and nested, the units in the names.
    arrays : mapping of name to NamedArray
        Written as they are: a third smaller when packed, and packing them takes longer than writing them.
    software_version, input_sha256 : str
        What made the calibration, and from which scan.

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


def read_arrays(path: Path, *names: str) -> dict[str, NDArray[Any]]:
    """Those arrays of result.h5 that it holds, by name."""
    with open_hdf5(path) as file:
        group = file[ARRAYS]
        return {name: np.asarray(group[name][()]) for name in names if name in group}


def read_calibration(path: Path) -> CalibrationRecord:
    """Read result.h5 of a calibration."""
    with open_hdf5(path) as file:
        arrays = {name: np.asarray(dataset[()]) for name, dataset in file[ARRAYS].items()}
        return CalibrationRecord(answer=json.loads(file[ANSWER][()]), arrays=arrays)
