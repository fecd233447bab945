"""The pieces of NeXus that all written files share, and the paths of a reconstructed volume (NXtomoproc)."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

CHUNK_BYTES = 16 * 2**20
PROGRAM = "sawmill-calibration"
# Lossless, and filters that every HDF5 library has.
PACKED = MappingProxyType({"compression": "gzip", "compression_opts": 1, "shuffle": True})

UNIT_SUFFIXES = frozenset({"mm", "rad", "deg", "s"})


def new_entry(file: h5py.File, definition: str | None = None, *, timed: bool = True) -> h5py.Group:
    """Make the NXentry of a new file, with its definition and, if it is `timed`, the time of writing."""
    file.attrs["default"] = "entry"
    entry = new_group(file, "entry", "NXentry")
    if definition is not None:
        entry["definition"] = definition
    if timed:
        entry["start_time"] = datetime.now(UTC).isoformat(timespec="seconds")
    return entry


def new_group(parent: h5py.Group, name: str, nx_class: str) -> h5py.Group:
    """Make a group of a NeXus class."""
    group = parent.create_group(name)
    group.attrs["NX_class"] = nx_class
    return group


def write_process(entry: h5py.Group, name: str, software_version: str, input_sha256: str) -> h5py.Group:
    """Write which program wrote a file, when, and from which scan."""
    process = new_group(entry, name, "NXprocess")
    process["program"], process["version"] = PROGRAM, software_version
    process["date"] = datetime.now(UTC).isoformat(timespec="seconds")
    process["input_sha256"] = input_sha256
    return process


def write_scalar(group: h5py.Group, name: str, value: ArrayLike, units: str) -> None:
    """Write a number or a short list of numbers with its unit."""
    group[name] = value
    group[name].attrs["units"] = units


def unit_of(name: str) -> str | None:
    """Return the unit at the end of a name, as in `detector_pitch_mm`; None where there is none."""
    if name.endswith("_per_mm"):
        return "1/mm"
    _, separator, suffix = name.rpartition("_")
    return suffix if separator and suffix in UNIT_SUFFIXES else None


def write_mapping(parent: h5py.Group, name: str, values: Mapping[str, Any], units: str | None = None) -> None:
    """Write nested JSON-able values as groups of datasets, each with the unit in its name or its group's name.

    Null becomes an empty dataset, a list of texts an array of them; any other list that is no array of one type
    becomes its JSON text.
    """
    group = new_group(parent, name, "NXcollection")
    for key, value in values.items():
        unit = unit_of(key) or units
        if isinstance(value, Mapping):
            write_mapping(group, key, value, unit)
            continue
        group[key] = _as_dataset(value)
        if unit is not None and not isinstance(value, str):
            group[key].attrs["units"] = unit


def _as_dataset(value: Any) -> Any:  # noqa: ANN401 - walks any JSON value
    if value is None:
        return h5py.Empty("f8")
    if not isinstance(value, list | tuple):
        return value
    if all(isinstance(text, str) for text in value):
        return np.array(value, h5py.string_dtype())
    try:
        array = np.array(value)
    except ValueError:
        return json.dumps(value)
    return array if array.dtype.kind in "biuf" else json.dumps(value)


DEFINITION = "NXtomoproc"
ENTRY = "entry"
# The volume with its axes x, y and z (or slice), where NXtomoproc expects it.
PLOT = f"{ENTRY}/data"
# Origin of the volume, with the volume and its axes linked; NXtomoproc requires this group under the name PROCESS.
RECONSTRUCTION = f"{ENTRY}/reconstruction"
PROCESS = f"{ENTRY}/process"
# Names in both groups: the volume, and the standard deviation of each pixel.
VALUES = "data"
DEVIATION = "data_errors"
# Curve from which Tikhonov's alpha was chosen: a column each.
ALPHA_CURVE = f"{RECONSTRUCTION}/alpha_curve"
ALPHA_COLUMNS = ("alphas", "residual_norms", "solution_norms", "alpha", "gcv")
# Densest values seen from the side: `side_view` for each axis.
SIDE_VIEWS = f"{ENTRY}/side_view"


def side_view(along: str) -> str:
    """Return the group of the side view along x or y."""
    return f"{SIDE_VIEWS}/along_{along}"
