"""The group by which VTK's own reader, and so ParaView, finds a volume in an HDF5 file.

Layout: docs.vtk.org, VTKHDF file format, ImageData.
"""

from collections.abc import Sequence

import h5py
import numpy as np
from numpy.typing import NDArray

_GROUP, _POINTS = "VTKHDF", "VTKHDF/PointData"
# VTK counts along an array's last axis first, and that is y: its (i, j, k) run along y, x and z. Volumes are drawn only
# where these three are right-handed, so the slices are in reverse order.
_ALONG_Y_X_MINUS_Z = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))


def describe_image(
    volume: h5py.Dataset, name: str, axes_mm: Sequence[NDArray[np.float64]], spacing_mm: Sequence[float]
) -> None:
    """Describe the positions of a volume's values (z, x, y) to VTK: each is a point in the middle of its pixel.

    `axes_mm` (z, x, y): centres of the pixels along each axis. `spacing_mm` (z, x, y): distances between the centres.
    """
    z_mm, x_mm, y_mm = axes_mm
    group = volume.file.create_group(_GROUP)
    # The oldest version that has images, so that every reader accepts it.
    group.attrs["Version"] = np.array([1, 0])
    # Readers require texts of fixed length.
    group.attrs["Type"] = np.bytes_("ImageData")
    group.attrs["WholeExtent"] = np.ravel([(0, length - 1) for length in reversed(volume.shape)])
    group.attrs["Origin"] = np.array([x_mm[0], y_mm[0], z_mm[-1]])
    group.attrs["Spacing"] = np.array(spacing_mm[::-1])
    group.attrs["Direction"] = np.ravel(_ALONG_Y_X_MINUS_Z)
    volume.file.create_group(_POINTS)
    _add_values(volume, name)
    volume.file[_POINTS][name].attrs["Attribute"] = np.bytes_("Scalars")


def _add_values(values: h5py.Dataset, name: str) -> None:
    """Give VTK the values (z, x, y) of the pixels; nothing is copied."""
    source = h5py.VirtualSource(".", values.name, values.shape)
    if len(values) == 1:
        # VTK reads an image of one slice from two axes.
        layout = h5py.VirtualLayout(values.shape[1:], values.dtype)
        layout[...] = source[0]
    else:
        layout = h5py.VirtualLayout(values.shape, values.dtype)
        for n in range(len(values)):
            layout[len(values) - 1 - n] = source[n]
    values.file[_POINTS].create_virtual_dataset(name, layout)
