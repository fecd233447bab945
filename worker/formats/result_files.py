"""Results to hand out: reconstructed volumes and calibrations as HDF5."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from worker.formats.atomic import whole_hdf5
from worker.formats.nexus import PROGRAM, new_entry, new_group, write_compressed, write_mapping, write_scalar


def write_reconstruction(
    path: Path,
    volume: NDArray[np.float32],
    *,
    pixel_mm: float,
    row_pitch_mm: float | None,
    unit: str,
    geometry: Mapping[str, Any],
    parameters: Mapping[str, Any],
    software_version: str,
    input_sha256: str,
) -> None:
    """Write a volume as /entry/reconstruction/data, laid out as NXtomoproc.

    Parameters
    ----------
    volume : (slice, x, y) float32
        The rotation centre in the middle.
    pixel_mm : float
        Side of a pixel.
    row_pitch_mm : float or None
        Distance between slices; None where they have no spacing, then the slice axis counts them.
    unit : str
        Of the volume's values, as in `1/mm`.
    geometry, parameters : mapping
        JSON-able, the units in the names.
    software_version, input_sha256 : str
        What made the volume, and from which scan.

    Raises
    ------
    ValueError
        When the volume has not three axes.
    OSError
        When the file cannot be written.
    """
    if volume.ndim != 3:
        raise ValueError(f"a volume must be (slice, x, y), not of shape {volume.shape}")
    with whole_hdf5(path) as file:
        entry = new_entry(file, "NXtomoproc")
        entry.attrs["default"] = "reconstruction"
        _write_volume(entry, volume.astype(np.float32, copy=False), unit, pixel_mm, row_pitch_mm)
        # NXtomoproc has its volume in /entry/data: the same group by another name.
        entry["data"] = entry["reconstruction"]
        _write_process(entry, software_version, input_sha256)
        write_mapping(entry["process"], "parameters", parameters)
        write_mapping(entry, "geometry", geometry)


def write_calibration(
    path: Path,
    result: Mapping[str, Any],
    arrays: Mapping[str, tuple[NDArray[Any], str, str]],
    *,
    software_version: str,
    input_sha256: str,
) -> None:
    """Write a calibration: its answer as JSON text and as groups, and the arrays behind it.

    Parameters
    ----------
    result : mapping
        JSON-able and nested, the units in the names.
    arrays : mapping of name to (array, unit, axes)
        The axes as one description, as in `view, detector`.
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
        _write_process(entry, software_version, input_sha256)
        entry["calibration_json"] = text
        write_mapping(entry, "calibration", result)
        group = new_group(entry, "arrays", "NXcollection")
        for name, (values, unit, axes) in arrays.items():
            dataset = write_compressed(group, name, values, unit, values.shape)
            dataset.attrs["axes_description"] = axes


def _write_volume(
    entry: h5py.Group, volume: NDArray[np.float32], unit: str, pixel_mm: float, row_pitch_mm: float | None
) -> None:
    slices, size_x, size_y = volume.shape
    data = new_group(entry, "reconstruction", "NXdata")
    data.attrs["signal"] = "data"
    data.attrs["axes"] = ["z" if row_pitch_mm is not None else "slice", "x", "y"]
    write_compressed(data, "data", volume, unit, (1, size_x, size_y))
    write_scalar(data, "x", _centres_mm(size_x, pixel_mm), "mm")
    write_scalar(data, "y", _centres_mm(size_y, pixel_mm), "mm")
    if row_pitch_mm is not None:
        write_scalar(data, "z", _centres_mm(slices, row_pitch_mm), "mm")
    else:
        write_scalar(data, "slice", np.arange(slices), "1")


def _centres_mm(count: int, spacing_mm: float) -> NDArray[np.float64]:
    # Pixel centres at -half + (i + 1/2) h, DESIGN section 3.
    return (np.arange(count, dtype=np.float64) + 0.5 - count / 2) * spacing_mm


def _write_process(entry: h5py.Group, software_version: str, input_sha256: str) -> None:
    process = new_group(entry, "process", "NXprocess")
    process["program"], process["version"] = PROGRAM, software_version
    process["input_sha256"] = input_sha256
