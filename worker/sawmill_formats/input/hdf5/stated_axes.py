"""The order of a dataset's axes as the file states it: attributes of CIL, Data Exchange and NeXus."""

import re

import h5py
import numpy as np

from sawmill_formats.input.hdf5.guard import name_of
from sawmill_formats.input.hdf5.texts import attribute, attribute_text

VIEWS = re.compile("angles?|theta|rotation_angle|views?|projections?|frames?|phi", re.IGNORECASE)
ROWS = re.compile("vertical|y|rows?|v", re.IGNORECASE)
CELLS = re.compile("horizontal|x|columns?|cells?|detector|u", re.IGNORECASE)


def stated_order(dataset: h5py.Dataset) -> tuple[int, ...] | None:
    """Return the dataset's axes in the order views, rows, cells; None where that is their order, or none is stated."""
    axes, numbers = (VIEWS, ROWS, CELLS) if dataset.ndim == 3 else (VIEWS, CELLS), range(dataset.ndim)
    is_signal = attribute_text(dataset.parent, "signal") == name_of(dataset).strip("'").rpartition("/")[2]
    candidates: list[list[str | None]] = [
        *([attribute_text(dataset, f"{form}{axis}") for axis in numbers] for form in ("dimension", "dim")),
        [*re.findall(r"\w+", attribute_text(dataset, "axes") or "")],
        np.asarray(attribute(dataset.parent, "axes") if is_signal else ()).astype(str).reshape(-1).tolist(),
    ]
    for names in candidates:
        order = [index for words in axes for index, name in enumerate(names) if words.fullmatch(name or "")]
        if len(names) == dataset.ndim and sorted(order) == [*numbers]:
            return None if order == [*numbers] else tuple(order)
    return None
