"""HDF5 in the Data Exchange layout: /exchange/data, with data_white, data_dark and theta in the same group."""

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, LinkedFiles, check_scan_dimensions
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.hdf5.fields import read_angles, read_pitch
from sawmill_formats.input.hdf5.guard import find, numbers, read_float32
from sawmill_formats.input.hdf5.projections import all_views
from sawmill_formats.input.hdf5.texts import attribute_text

DATA = "exchange/data"
DETECTOR = "measurement/instrument/detector"


def is_exchange(file: h5py.File, linked: LinkedFiles | None = None) -> bool:
    """Return whether the file has the group and the dataset of this layout."""
    return isinstance(find(file, DATA, linked), h5py.Dataset)


def read_exchange(file: h5py.File, bounds: Bounds) -> FileContents:
    """Read /exchange; theta is in degrees unless its units attribute says otherwise, as the layout defines it.

    Raises
    ------
    UnreadableScan
        When the parts cannot be read.
    """
    dataset = numbers(file, DATA, bounds)
    if dataset is None:
        raise UnreadableScan("dataset-missing", f"the file has no {DATA}")
    check_scan_dimensions(DATA, dataset.shape)
    axes = attribute_text(dataset, "axes")
    if axes is not None and not axes.startswith("theta"):
        raise UnreadableScan(
            "wrong-shape", f"{DATA} has the axes {quoted(axes)!r}; store it as theta:y:x, one view after the other"
        )
    angles = read_angles(file, "exchange/theta", bounds.whole, default_unit="deg")
    detector_pitch_mm, remarks_x = read_pitch(file, f"{DETECTOR}/x_pixel_size", bounds.whole)
    row_pitch_mm, remarks_y = read_pitch(file, f"{DETECTOR}/y_pixel_size", bounds.whole)
    return FileContents(
        format="hdf5-data-exchange",
        projections=all_views(dataset),
        flats=_optional(file, "exchange/data_white", bounds.whole),
        darks=_optional(file, "exchange/data_dark", bounds.whole),
        angles_deg=angles.deg,
        angles_unit=angles.unit,
        angles_unusable=angles.unusable,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
        remarks=(*remarks_x, *remarks_y),
    )


def _optional(file: h5py.File, path: str, bounds: Bounds) -> NDArray[np.float32] | None:
    dataset = numbers(file, path, bounds)
    return None if dataset is None else read_float32(dataset)
