"""HDF5 in the Data Exchange layout: /exchange/data, with data_white, data_dark and theta in the same group."""

import h5py

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, check_scan_dimensions
from sawmill_formats.input.contents import FileContents, Wanted
from sawmill_formats.input.hdf5 import fields
from sawmill_formats.input.hdf5.guard import attribute_text, numbers

EXCHANGE_DATA = "exchange/data"
DETECTOR = "measurement/instrument/detector"


def read_exchange(file: h5py.File, bounds: Bounds, selection: Wanted) -> FileContents:
    """Read /exchange; theta is in degrees unless its units attribute says otherwise, as the layout defines it."""
    dataset = numbers(file, EXCHANGE_DATA, bounds)
    if dataset is None:
        raise UnreadableScan("dataset-missing", f"the file has no {EXCHANGE_DATA}")
    check_scan_dimensions(EXCHANGE_DATA, dataset.shape)
    axes, order = attribute_text(dataset, "axes"), selection.order(dataset.ndim) or fields.stated_order(dataset)
    if axes is not None and not axes.startswith("theta") and order is None:
        raise UnreadableScan(
            "wrong-shape",
            f"{EXCHANGE_DATA} has the axes {quoted(axes)!r}; store it as theta:y:x, one view after the other",
        )
    angles = fields.read_angles(file, "exchange/theta", bounds.whole, default_unit="deg")
    pitch, row_pitch = (fields.read_pitch(file, f"{DETECTOR}/{axis}_pixel_size", bounds.whole) for axis in "xy")
    white, dark, theta = (
        numbers(file, f"exchange/{name}", bounds.whole) for name in ("data_white", "data_dark", "theta")
    )
    contents = FileContents(
        format="hdf5-data-exchange",
        projections=fields.all_views(dataset),
        flats=None if white is None else fields.read_unpacked(white),
        darks=None if dark is None else fields.read_unpacked(dark),
        angles=angles,
        pitch=pitch,
        row_pitch=row_pitch,
        order=order,
        remarks=(*fields.packing_remarks(dataset, white, dark, theta), *pitch.remarks, *row_pitch.remarks),
    )
    return fields.with_fields_beside(contents, dataset, bounds.whole, selection)
