"""HDF5 in the Data Exchange layout: /exchange/data, with data_white, data_dark and theta in the same group."""

import h5py

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, LinkedFiles, check_scan_dimensions
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.hdf5.fields import (
    all_views,
    packing_remarks,
    read_angles,
    read_pitch,
    read_unpacked,
    stated_order,
    with_fields_beside,
)
from sawmill_formats.input.hdf5.guard import find, numbers
from sawmill_formats.input.hdf5.texts import attribute_text
from sawmill_formats.input.wanted import Wanted

DATA = "exchange/data"
DETECTOR = "measurement/instrument/detector"


def is_exchange(file: h5py.File, linked: LinkedFiles | None = None) -> bool:
    """Return whether the file has the group and the dataset of this layout."""
    return isinstance(find(file, DATA, linked), h5py.Dataset)


def read_exchange(file: h5py.File, bounds: Bounds, selection: Wanted) -> FileContents:
    """Read /exchange; theta is in degrees unless its units attribute says otherwise, as the layout defines it."""
    dataset = numbers(file, DATA, bounds)
    if dataset is None:
        raise UnreadableScan("dataset-missing", f"the file has no {DATA}")
    check_scan_dimensions(DATA, dataset.shape)
    axes, order = attribute_text(dataset, "axes"), selection.order(dataset.ndim) or stated_order(dataset)
    if axes is not None and not axes.startswith("theta") and order is None:
        raise UnreadableScan(
            "wrong-shape", f"{DATA} has the axes {quoted(axes)!r}; store it as theta:y:x, one view after the other"
        )
    angles = read_angles(file, "exchange/theta", bounds.whole, default_unit="deg")
    pitch, row_pitch = (read_pitch(file, f"{DETECTOR}/{axis}_pixel_size", bounds.whole) for axis in "xy")
    white, dark, theta = (
        numbers(file, f"exchange/{name}", bounds.whole) for name in ("data_white", "data_dark", "theta")
    )
    contents = FileContents(
        format="hdf5-data-exchange",
        projections=all_views(dataset),
        flats=None if white is None else read_unpacked(white),
        darks=None if dark is None else read_unpacked(dark),
        angles=angles,
        pitch=pitch,
        row_pitch=row_pitch,
        order=order,
        remarks=(*packing_remarks(dataset, white, dark, theta), *pitch.remarks, *row_pitch.remarks),
    )
    return with_fields_beside(contents, dataset, bounds.whole, selection)
