"""Projections in an HDF5 dataset, read block by block as it is stored."""

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.input.contents import Projections
from sawmill_formats.input.hdf5.guard import read_images
from sawmill_formats.input.hdf5.packed_values import scaling_of


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
