"""Results to hand out: reconstructed volumes and calibrations as HDF5."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_worker.formats.atomic import whole_hdf5
from sawmill_worker.formats.errors import UnreadableScan, library_errors_translated
from sawmill_worker.formats.hdf5_guard import open_hdf5, read_text
from sawmill_worker.formats.nexus import PACKED, PROGRAM, new_entry, new_group, write_mapping, write_scalar
from sawmill_worker.formats.packing import write_packed
from sawmill_worker.formats.vtk_hdf import add_values, describe_image

# Slices a chunk of the side views: about as many as are written at a time.
SIDE_VIEW_ROWS = 64
# Where a calibration's answer lies as JSON text, and the most bytes that are read of one: it has some ten thousand.
ANSWER = "entry/calibration_json"
LONGEST_ANSWER = 16 * 2**20


class NamedArray(NamedTuple):
    """An array or a single number with its unit, and its axes in words, as in `view, detector`."""

    values: NDArray[Any]
    unit: str
    axes: str


class NewVolume:
    """A volume that is being written, from any thread."""

    def __init__(self, entry: h5py.Group, volume: h5py.Dataset) -> None:
        self._entry, self._volume = entry, volume
        self._along_x, self._along_y = _new_side_views(entry)

    def write(self, first: int, slices: NDArray[np.float32]) -> None:
        """Write slices (slices, x, y), and what is densest in them from the side."""
        _write_slices(self._volume, first, slices)
        written = np.s_[first : first + len(slices)]
        self._along_x[written], self._along_y[written] = slices.max(axis=1), slices.max(axis=2)

    def write_deviation(self, first: int, slices: NDArray[np.float32]) -> None:
        """Write the standard deviation of each pixel of slices (slices, x, y)."""
        group = self._entry["data"]
        if "data_errors" not in group:
            errors = _new_pixels(group, "data_errors", self._volume.shape, self._volume.attrs["units"])
            self._entry["reconstruction/data_errors"] = errors
            add_values(errors, "standard_deviation")
        _write_slices(group["data_errors"], first, slices)

    def note_method(self, report: Mapping[str, Any]) -> None:
        """Write down what the method did; JSON-able, the units in the names."""
        write_mapping(self._entry["reconstruction"], "method", report)

    def note_alpha_curve(self, columns: Mapping[str, NDArray[np.float64]]) -> None:
        """Write down what a rule for Tikhonov's alpha saw, a column each."""
        group = new_group(self._entry["reconstruction"], "alpha_curve", "NXcollection")
        for name, values in columns.items():
            group[name] = values


def _write_slices(dataset: h5py.Dataset, first: int, slices: NDArray[np.float32]) -> None:
    for n, values in enumerate(slices, first):
        write_packed(dataset, n, values)


@contextmanager
def new_reconstruction(
    path: Path,
    shape: tuple[int, int, int],
    *,
    pixel_mm: float,
    row_pitch_mm: float | None,
    unit: str,
    geometry: Mapping[str, Any],
    parameters: Mapping[str, Any],
    software_version: str,
    input_sha256: str,
    centre_mm: tuple[float, float] = (0.0, 0.0),
    first_slice_mm: float = 0.0,
) -> Iterator[NewVolume]:
    """Yield what writes slices of a volume into /entry/reconstruction/data, laid out as NXtomoproc and as VTKHDF.

    The volume is stored once: in /entry/data, where NXtomoproc wants it; /VTKHDF has a virtual dataset of it.
    The file is there when the block has ended well, and not before.

    Parameters
    ----------
    shape : (slice, x, y)
        Of the whole volume.
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
    centre_mm : (x, y)
        Middle of the slices, the rotation centre at (0, 0).
    first_slice_mm : float
        Where the first slice lies along the log.

    Raises
    ------
    OSError
        When the file cannot be written.
    """
    with whole_hdf5(path) as file:
        entry = new_entry(file, "NXtomoproc")
        entry["title"] = "Attenuation of a log, in slices {} x {} x {}".format(*shape)
        x_mm, y_mm = (_centres_mm(size, pixel_mm) + middle for size, middle in zip(shape[1:], centre_mm, strict=True))
        along = np.arange(shape[0], dtype=np.float64)
        if row_pitch_mm is not None:
            along = first_slice_mm + along * row_pitch_mm
        volume = _new_volume(entry, unit, along, x_mm, y_mm, spaced=row_pitch_mm is not None)
        spacing_mm = (row_pitch_mm or 1.0, pixel_mm, pixel_mm)
        describe_image(volume, "attenuation", (along, x_mm, y_mm), spacing_mm)
        _write_origin(entry)
        process = _write_process(entry, "reconstruction", software_version, input_sha256)
        # The scan's file had a name where it came from; here it is known by its checksum.
        write_mapping(process, "parameters", {**parameters, "raw_file": f"sha256:{input_sha256}"})
        process["parameters"].attrs["NX_class"] = "NXparameters"
        for name in ("data", *entry["data"].attrs["axes"]):
            process[name] = entry["data"][name]
        entry["process"] = process
        write_mapping(entry, "geometry", geometry)
        writing = NewVolume(entry, volume)
        yield writing


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
        _write_process(entry, "process", software_version, input_sha256)
        file[ANSWER] = text
        write_mapping(entry, "calibration", result)
        group = new_group(entry, "arrays", "NXcollection")
        for name, (values, unit, axes) in arrays.items():
            write_scalar(group, name, values, unit)
            group[name].attrs["axes_description"] = axes


def read_calibration_json(path: Path) -> str:
    """The answer as JSON text, from a file that `write_calibration` made, or that somebody says it made.

    Raises
    ------
    UnreadableScan
        `dataset-missing` where the file is another one; it is damaged, or the text is too long.
    """
    with library_errors_translated("HDF5"), open_hdf5(path) as file:
        text = read_text(file, ANSWER, most_bytes=LONGEST_ANSWER)
    if text is None:
        raise UnreadableScan("dataset-missing", f"it is HDF5 without /{ANSWER}")
    return text


def _new_volume(
    entry: h5py.Group,
    unit: str,
    along: NDArray[np.float64],
    x_mm: NDArray[np.float64],
    y_mm: NDArray[np.float64],
    *,
    spaced: bool,
) -> h5py.Dataset:
    data = new_group(entry, "data", "NXdata")
    entry.attrs["default"] = "data"
    data.attrs["signal"] = "data"
    data.attrs["axes"] = ["z" if spaced else "slice", "x", "y"]
    data["title"] = entry["title"]
    volume = _new_pixels(data, "data", (len(along), len(x_mm), len(y_mm)), unit)
    volume.attrs["long_name"] = f"attenuation ({unit})"
    # NXtomoproc asks, in texts, how values became numbers: they are stored as they are.
    volume.attrs["transform"], volume.attrs["offset"], volume.attrs["scaling"] = "none", "0", "1"
    write_scalar(data, "x", x_mm, "mm")
    write_scalar(data, "y", y_mm, "mm")
    if spaced:
        write_scalar(data, "z", along, "mm")
        data["z"].attrs["long_name"] = "z, along the log (mm)"
    else:
        write_scalar(data, "slice", along, "1")
        data["slice"].attrs["long_name"] = "slice"
        # NXtomoproc requires a z, in whatever unit.
        data["z"] = data["slice"]
    return volume


def _new_pixels(group: h5py.Group, name: str, shape: tuple[int, ...], unit: str) -> h5py.Dataset:
    volume: h5py.Dataset = group.create_dataset(
        name, shape, np.float32, chunks=(1, *shape[1:]), **PACKED, fletcher32=True
    )
    volume.attrs["units"] = unit
    return volume


def _new_side_views(entry: h5py.Group) -> list[h5py.Dataset]:
    """The maximum of each slice along x, (slice, y), and along y, (slice, x), still to be written."""
    volume = entry["data"]
    slice_axis, x, y = volume.attrs["axes"]
    views = new_group(entry, "side_view", "NXcollection")
    datasets = []
    for along, across in ((x, y), (y, x)):
        view = new_group(views, f"along_{along}", "NXdata")
        view.attrs["signal"] = "data"
        view.attrs["axes"] = [slice_axis, across]
        view["title"] = f"Densest along {along}"
        for axis in (slice_axis, across):
            view[axis] = volume[axis]
        shape = len(volume[slice_axis]), len(volume[across])
        chunks = min(shape[0], SIDE_VIEW_ROWS), shape[1]
        data = view.create_dataset("data", shape, np.float32, chunks=chunks, **PACKED, fletcher32=True)
        for name in ("units", "long_name"):
            data.attrs[name] = volume["data"].attrs[name]
        datasets.append(data)
    return datasets


def _centres_mm(count: int, spacing_mm: float) -> NDArray[np.float64]:
    # Pixel centres at -half + (i + 1/2) h, DESIGN section 3.
    return (np.arange(count, dtype=np.float64) + 0.5 - count / 2) * spacing_mm


def _write_origin(entry: h5py.Group) -> None:
    """What NXtomoproc wants to know of the source and the sample."""
    source = new_group(new_group(entry, "instrument", "NXinstrument"), "source", "NXsource")
    source["type"], source["name"], source["probe"] = "Fixed Tube X-ray", "X-ray tube of the sawmill's scanner", "x-ray"
    new_group(entry, "sample", "NXsample")["name"] = "log"


def _write_process(entry: h5py.Group, name: str, software_version: str, input_sha256: str) -> h5py.Group:
    process = new_group(entry, name, "NXprocess")
    process["program"], process["version"] = PROGRAM, software_version
    process["date"] = datetime.now(UTC).isoformat(timespec="seconds")
    process["input_sha256"] = input_sha256
    return process
