"""Reading back the volumes of `volume_writer`: slices, side views, and what alpha was chosen from."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_worker.files import volume_layout as layout
from sawmill_worker.files.errors import NotStored, check_index
from sawmill_worker.files.hdf5 import open_hdf5

Axis = Literal["x", "y"]


@dataclass(frozen=True)
class VolumeSlice:
    """One slice of a reconstruction.

    Attributes
    ----------
    data : (x, y) float32
        Attenuation in `unit`.
    index
        Of the slice, from 0.
    height_mm
        Where it lies along the log; None where slices have no spacing.
    pixel_mm
        Distance between pixels.
    first_pixel_mm : (x, y)
        Where the centre of pixel [0, 0] lies.
    unit
        Of the data.
    """

    data: NDArray[np.float32]
    index: int
    height_mm: float | None
    pixel_mm: float
    first_pixel_mm: tuple[float, float]
    unit: str

    @property
    def label(self) -> str:
        """Which slice it is, and where it lies."""
        return f"slice {self.index}" if self.height_mm is None else f"slice {self.index}, {self.height_mm:g} mm"


@dataclass(frozen=True)
class VolumeGrid:
    """Where a volume's slices and pixels lie.

    Attributes
    ----------
    shape : (slice, x, y)
    pixel_mm
        Distance between pixels.
    first_pixel_mm : (x, y)
        Where the centre of pixel [0, 0] lies.
    first_height_mm, spacing_mm
        Where slice 0 lies along the log, and the distance to the next one; None where slices have no spacing.
    """

    shape: tuple[int, int, int]
    pixel_mm: float
    first_pixel_mm: tuple[float, float]
    first_height_mm: float | None
    spacing_mm: float | None


@dataclass(frozen=True)
class SideView:
    """The densest values of a reconstruction, looked at from the side.

    Attributes
    ----------
    data : (slice, x or y) float32
        The maximum over the other axis of each slice, in `unit`.
    across
        The axis that is left: x or y.
    across_mm : (low, high)
        Ends of the field along it.
    along_mm : (low, high) or None
        Ends of the log along its length; None where slices have no spacing.
    unit
        Of the data.
    """

    data: NDArray[np.float32]
    across: str
    across_mm: tuple[float, float]
    along_mm: tuple[float, float] | None
    unit: str


def volume_grid(path: Path) -> VolumeGrid:
    """Read where the slices and pixels of volume.h5 lie."""
    with open_hdf5(path) as file:
        group = file[layout.RECONSTRUCTION]
        x_mm = group["x"]
        heights = [float(height) for height in group["z"][:2]] if "z" in group else []
        return VolumeGrid(
            shape=group[layout.VALUES].shape,
            pixel_mm=float(x_mm[1] - x_mm[0]),
            first_pixel_mm=(float(x_mm[0]), float(group["y"][0])),
            first_height_mm=heights[0] if heights else None,
            spacing_mm=heights[1] - heights[0] if len(heights) > 1 else None,
        )


def volume_slice(path: Path, index: int) -> VolumeSlice:
    """Read one slice of volume.h5.

    Raises
    ------
    OutOfRange
        The volume has no such slice.
    """
    return next(volume_slices(path, [index]))


def volume_slices(path: Path, indices: Iterable[int]) -> Iterator[VolumeSlice]:
    """Read slices of volume.h5, one at a time.

    Raises
    ------
    OutOfRange
        The volume has no such slice.
    """
    with open_hdf5(path) as file:
        yield from _slices(file[layout.RECONSTRUCTION], layout.VALUES, indices)


def _slices(group: h5py.Group, name: str, indices: Iterable[int]) -> Iterator[VolumeSlice]:
    data, x_mm = group[name], group["x"]
    for index in indices:
        check_index("slice", index, data.shape[0])
        yield VolumeSlice(
            data=data[index],
            index=index,
            height_mm=float(group["z"][index]) if "z" in group else None,
            pixel_mm=float(x_mm[1] - x_mm[0]),
            first_pixel_mm=(float(x_mm[0]), float(group["y"][0])),
            unit=_text(data.attrs["units"]),
        )


def deviation_slice(path: Path, index: int) -> VolumeSlice:
    """Read the standard deviation of each pixel of a slice of volume.h5.

    Raises
    ------
    OutOfRange, NotStored
        The volume has no such slice, or no standard deviations.
    """
    with open_hdf5(path) as file:
        if layout.DEVIATION not in file[layout.RECONSTRUCTION]:
            raise NotStored("no-deviation", "this volume has no standard deviations: only earlier versions made them")
        return next(_slices(file[layout.RECONSTRUCTION], layout.DEVIATION, [index]))


def alpha_curve(path: Path) -> dict[str, NDArray[Any]]:
    """Read what Tikhonov's alpha was chosen from, by column.

    Raises
    ------
    NotStored
        The volume was reconstructed by another method, or shows nothing.
    """
    with open_hdf5(path) as file:
        if layout.ALPHA_CURVE not in file:
            raise NotStored("no-alpha-curve", "no alpha was chosen: not by method tikhonov, or nothing there to see")
        return {name: column[()] for name, column in file[layout.ALPHA_CURVE].items()}


def side_view(path: Path, along: Axis) -> SideView:
    """Read what volume.h5 shows when looked at along x or along y; the slices themselves are not read.

    Raises
    ------
    NotStored
        The volume was written before side views were stored.
    """
    with open_hdf5(path) as file:
        if layout.side_view(along) not in file:
            raise NotStored("no-side-view", "this volume was written without side views: reconstruct the scan again")
        view = file[layout.side_view(along)]
        across = "y" if along == "x" else "x"
        across_mm = view[across][()]
        pixel_mm = float(across_mm[1] - across_mm[0])
        return SideView(
            data=view["data"][()],
            across=across,
            across_mm=_ends(across_mm, pixel_mm),
            # One slice alone has no spacing: it is shown as thick as its pixels are wide.
            along_mm=_ends(view["z"][()], pixel_mm) if "z" in view else None,
            unit=_text(view["data"].attrs["units"]),
        )


def _ends(centres_mm: NDArray[np.float64], only_mm: float) -> tuple[float, float]:
    """Half a spacing beyond the first and the last; `only_mm` is the spacing of one alone."""
    half = 0.5 * float(centres_mm[1] - centres_mm[0] if len(centres_mm) > 1 else only_mm)
    return float(centres_mm[0]) - half, float(centres_mm[-1]) + half


def _text(value: Any) -> str:  # noqa: ANN401 - h5py gives str or bytes, as the file was written
    return value.decode() if isinstance(value, bytes) else str(value)
