"""Reading what our own jobs wrote, a row or a slice at a time, for pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from worker.storage.errors import Invalid

_DETECTOR = "/entry/instrument/detector"


@dataclass(frozen=True)
class Sinogram:
    """One detector row of a scan.

    Attributes
    ----------
    data : (views, detector) float32
        Line integrals, dimensionless.
    angles_deg : (views,) float64
        Each view's angle.
    pitch_mm
        Distance between detector cells.
    """

    data: NDArray[np.float32]
    angles_deg: NDArray[np.float64]
    pitch_mm: float


@dataclass(frozen=True)
class VolumeSlice:
    """One slice of a reconstruction.

    Attributes
    ----------
    data : (x, y) float32
        Attenuation in `unit`, the rotation centre in the middle.
    pixel_mm
        Distance between pixels.
    unit
        Of the data.
    """

    data: NDArray[np.float32]
    pixel_mm: float
    unit: str


def sinogram(path: Path, row: int) -> Sinogram:
    """Read one detector row of scan.h5.

    Raises
    ------
    Invalid
        The scan has no such row.
    """
    with h5py.File(path, "r") as file:
        data = file[f"{_DETECTOR}/data"]
        _check_index("row", row, data.shape[1])
        return Sinogram(
            data=data[:, row, :],
            angles_deg=file["/entry/sample/rotation_angle"][:].astype(np.float64),
            pitch_mm=float(file[f"{_DETECTOR}/x_pixel_size"][()]),
        )


def projection(path: Path, view: int) -> NDArray[np.float32]:
    """Read one view of scan.h5.

    Returns
    -------
    (row, detector) float32
        Line integrals, dimensionless.

    Raises
    ------
    Invalid
        The scan has no such view.
    """
    with h5py.File(path, "r") as file:
        data = file[f"{_DETECTOR}/data"]
        _check_index("view", view, data.shape[0])
        return np.asarray(data[view], dtype=np.float32)


def volume_slice(path: Path, index: int) -> VolumeSlice:
    """Read one slice of volume.h5.

    Raises
    ------
    Invalid
        The volume has no such slice.
    """
    with h5py.File(path, "r") as file:
        data = file["/entry/reconstruction/data"]
        _check_index("slice", index, data.shape[0])
        x_mm = file["/entry/reconstruction/x"]
        return VolumeSlice(data=data[index], pixel_mm=float(x_mm[1] - x_mm[0]), unit=_text(data.attrs["units"]))


def _check_index(what: str, index: int, length: int) -> None:
    if not 0 <= index < length:
        raise Invalid(f"{what}-out-of-range", f"{what} must be between 0 and {length - 1}, not {index}")


def _text(value: Any) -> str:  # noqa: ANN401 - h5py gives str or bytes, as the file was written
    return value.decode() if isinstance(value, bytes) else str(value)
