"""Projections in an HDF5 dataset: the order of their axes, and reading block by block as they are stored."""

import re

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.input.contents import Projections
from sawmill_formats.input.hdf5.guard import name_of, read_images
from sawmill_formats.input.hdf5.packed_values import scaling_of
from sawmill_formats.input.hdf5.texts import attribute, attribute_text


def all_views(dataset: h5py.Dataset) -> Projections:
    """Return the projections of a checked dataset (views, rows, detector) or (views, detector)."""
    return chosen_views(dataset, np.arange(len(dataset)))


def chosen_views(dataset: h5py.Dataset, images: NDArray[np.intp]) -> Projections:
    """Return the images with these rising indices of a checked dataset."""
    scaling = scaling_of(dataset)

    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        if dataset.ndim == 2:
            return scaling.apply(read_images(dataset, images[views])[:, np.newaxis])
        return scaling.apply(read_images(dataset, images[views], rows))

    # Sources of a virtual dataset usually are a camera's images, which are read as a whole.
    virtual = (1, *dataset.shape[1:]) if dataset.is_virtual else None
    return Projections((len(images), *dataset.shape[1:]), read, _together(virtual or dataset.chunks))


def _together(chunks: tuple[int, ...] | None) -> tuple[int, int]:
    if chunks is None:
        return 1, 1
    return (chunks[0], chunks[1]) if len(chunks) == 3 else (chunks[0], 1)


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
