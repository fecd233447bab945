"""Reading of the volumes of `volume_writer`: slices, side views, and the curve from which alpha was chosen."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats import nexus as layout
from sawmill_formats.errors import NotAsWritten, NotStored, check_index
from sawmill_formats.output import own_hdf5
from sawmill_vocabulary.side_view import SideView

Axis = Literal["x", "y"]
Shape = tuple[int, int, int]
# Most points of a curve for alpha.
MOST_POINTS = 10_000


@dataclass(frozen=True)
class VolumeSlice:
    """A slice of a reconstruction."""

    data: NDArray[np.float32]  # (x, y) float32: attenuation in `unit`
    index: int  # number of the slice, from 0
    height_mm: float | None  # position along the log; None where slices have no spacing
    pixel_mm: float  # distance between pixels
    first_pixel_mm: tuple[float, float]  # (x, y): centre of pixel [0, 0]
    unit: str  # unit of the data

    @property
    def label(self) -> str:
        """Number of the slice, and its position."""
        return f"slice {self.index}" if self.height_mm is None else f"slice {self.index}, {self.height_mm:g} mm"


@dataclass(frozen=True)
class VolumeGrid:
    """Positions of a volume's slices and pixels."""

    shape: tuple[int, int, int]  # (slice, x, y)
    pixel_mm: float  # distance between pixels
    first_pixel_mm: tuple[float, float]  # (x, y): centre of pixel [0, 0]
    # Position of slice 0 along the log, and the distance to the next slice; None where slices have no spacing
    first_height_mm: float | None
    spacing_mm: float | None


def check_volume(path: Path, shape: Shape) -> None:
    """Check that volume.h5 holds the recorded volume, and nothing that leads elsewhere; no slice is read.

    Parameters
    ----------
    shape : (slice, x, y)
        Shape as it is recorded; so in every function here.

    Raises
    ------
    DamagedResult
        It does not; every function here raises this.
    """
    with own_hdf5.reading_own(path) as file:
        own_hdf5.check_members(file, path, 4 * math.prod(shape))
        _grid(file, shape)
        own_hdf5.needed(_values(file, layout.VALUES, shape), layout.VALUES)
        for along in get_args(Axis):
            own_hdf5.dataset_at(file, f"{layout.side_view(along)}/data", _side_shape(shape, along), own_hdf5.PACKED)


def volume_grid(path: Path, shape: Shape) -> VolumeGrid:
    """Read the positions of the slices and pixels of volume.h5."""
    with own_hdf5.reading_own(path) as file:
        return _grid(file, shape)[0]


def _grid(file: h5py.File, shape: Shape) -> tuple[VolumeGrid, NDArray[np.float64] | None]:
    """Read the positions of slices and pixels, and the height of each slice; None where slices have no spacing."""
    z_mm = own_hdf5.values_at(file, f"{layout.RECONSTRUCTION}/z", shape[:1])
    x_mm = own_hdf5.values_of(file, f"{layout.RECONSTRUCTION}/x", shape[1:2])
    grid = VolumeGrid(
        shape=shape,
        pixel_mm=float(x_mm[1] - x_mm[0]),
        first_pixel_mm=(float(x_mm[0]), float(own_hdf5.values_of(file, f"{layout.RECONSTRUCTION}/y", shape[2:])[0])),
        first_height_mm=None if z_mm is None else float(z_mm[0]),
        spacing_mm=None if z_mm is None or len(z_mm) == 1 else float(z_mm[1] - z_mm[0]),
    )
    return grid, z_mm


def _values(file: h5py.File, name: str, shape: Shape) -> h5py.Dataset | None:
    return own_hdf5.dataset_at(file, f"{layout.RECONSTRUCTION}/{name}", shape, own_hdf5.PACKED)


def volume_slice(path: Path, shape: Shape, index: int) -> VolumeSlice:
    """Read one slice of volume.h5.

    Raises
    ------
    OutOfRange
        The volume has no such slice.
    """
    return next(volume_slices(path, shape, [index]))


def volume_slices(path: Path, shape: Shape, indices: Iterable[int]) -> Iterator[VolumeSlice]:
    """Read slices of volume.h5, one at a time.

    Raises
    ------
    OutOfRange
        The volume has no such slice.
    """
    with own_hdf5.reading_own(path) as file:
        yield from _slices(file, own_hdf5.needed(_values(file, layout.VALUES, shape), layout.VALUES), indices)


def _slices(file: h5py.File, values: h5py.Dataset, indices: Iterable[int]) -> Iterator[VolumeSlice]:
    (grid, heights_mm), unit = _grid(file, values.shape), own_hdf5.unit_of(values)
    for index in indices:
        check_index("slice", index, len(values))
        yield VolumeSlice(
            data=own_hdf5.read_packed(values, index, index + 1)[0],
            index=index,
            height_mm=None if heights_mm is None else float(heights_mm[index]),
            pixel_mm=grid.pixel_mm,
            first_pixel_mm=grid.first_pixel_mm,
            unit=unit,
        )


def deviation_slice(path: Path, shape: Shape, index: int) -> VolumeSlice:
    """Read the standard deviation of each pixel of a slice of volume.h5.

    Raises
    ------
    OutOfRange, NotStored
        The volume has no such slice, or no standard deviations.
    """
    with own_hdf5.reading_own(path) as file:
        deviations = _values(file, layout.DEVIATION, shape)
        if deviations is None:
            raise NotStored("no-deviation", "this volume has no standard deviations: only earlier versions made them")
        return next(_slices(file, deviations, [index]))


def alpha_curve(path: Path) -> dict[str, NDArray[Any]]:
    """Read the curve from which Tikhonov's alpha was chosen, by column.

    Raises
    ------
    NotStored
        The volume was reconstructed by another method, or is empty.
    """
    with own_hdf5.reading_own(path) as file:
        group = own_hdf5.group_at(file, layout.ALPHA_CURVE)
        if group is None:
            raise NotStored("no-alpha-curve", "no alpha was chosen: not by method tikhonov, or nothing there to see")
        points = own_hdf5.needed(own_hdf5.dataset_at(file, f"{layout.ALPHA_CURVE}/alphas"), "alphas").shape
        if len(points) != 1 or points[0] > MOST_POINTS:
            raise NotAsWritten(f"its alphas have the shape {points}")
        return {
            name: own_hdf5.values_of(file, f"{layout.ALPHA_CURVE}/{name}", () if name == "alpha" else points)
            for name in layout.ALPHA_COLUMNS
            if name in group
        }


def side_view(path: Path, shape: Shape, along: Axis) -> SideView:
    """Read the side view of volume.h5 along x or along y; the slices themselves are not read.

    Raises
    ------
    NotStored
        The volume was written before side views were stored.
    """
    with own_hdf5.reading_own(path) as file:
        view = layout.side_view(along)
        side_shape = _side_shape(shape, along)
        data = own_hdf5.dataset_at(file, f"{view}/data", side_shape, own_hdf5.PACKED)
        if data is None:
            raise NotStored("no-side-view", "this volume was written without side views: reconstruct the scan again")
        across = "y" if along == "x" else "x"
        across_mm = own_hdf5.values_of(file, f"{view}/{across}", side_shape[1:])
        along_mm = own_hdf5.values_at(file, f"{view}/z", side_shape[:1])
        pixel_mm = float(across_mm[1] - across_mm[0])
        return SideView(
            data=own_hdf5.read_packed(data, 0, len(data)),
            across=across,
            across_mm=_ends(across_mm, pixel_mm),
            # A single slice has no spacing: it is shown as thick as its pixels are wide.
            along_mm=None if along_mm is None else _ends(along_mm, pixel_mm),
            unit=own_hdf5.unit_of(data),
        )


def _side_shape(shape: Shape, along: Axis) -> tuple[int, int]:
    slices, x, y = shape
    return slices, y if along == "x" else x


def _ends(centres_mm: NDArray[np.float64], only_mm: float) -> tuple[float, float]:
    """Return the axis' ends, half a spacing beyond the first and last centre; `only_mm` is a single one's spacing."""
    half = 0.5 * float(centres_mm[1] - centres_mm[0] if len(centres_mm) > 1 else only_mm)
    return float(centres_mm[0]) - half, float(centres_mm[-1]) + half
