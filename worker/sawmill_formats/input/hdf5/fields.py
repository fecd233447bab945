"""Angles and pixel sizes, which both HDF5 layouts store as datasets with a units attribute."""

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileAngles
from sawmill_formats.input.hdf5.guard import Node, numbers, read_values
from sawmill_formats.input.hdf5.texts import attribute_text
from sawmill_formats.input.units import LARGEST_PITCH_MM, LEAST_PITCH_MM, length_of, to_degrees
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage


def read_angles(start: Node, path: str, bounds: Bounds, *, default_unit: str | None) -> FileAngles:
    """Read angles (n,) float64 in degrees, or the reason why the angles in the file cannot be used."""
    dataset = numbers(start, path, bounds)
    if dataset is None:
        return FileAngles()
    values = _read_vector(dataset, path)
    unit = attribute_text(dataset, "units") or default_unit
    if unit is None:
        return FileAngles(unusable=ReadingMessage.ANGLES_WITHOUT_UNIT(path=path))
    angles_deg = to_degrees(values, unit)
    if angles_deg is None:
        return FileAngles(unusable=ReadingMessage.ANGLES_OF_OTHER_UNIT(unit=quoted(unit), path=path))
    return FileAngles(angles_deg, quoted(unit))


def read_pitch(start: Node, path: str, bounds: Bounds) -> tuple[float | None, tuple[Reason, ...]]:
    """Read a pixel size in mm or None, and the remark why it was ignored.

    Raises
    ------
    UnreadableScan
        `out-of-range` for a size that no detector has; 0 or NaN means that the file does not know the size.
    """
    dataset = numbers(start, path, bounds)
    if dataset is None:
        return None, ()
    unit = attribute_text(dataset, "units")
    length_mm, problem = length_of(_read_vector(dataset, path), None if unit is None else quoted(unit))
    if length_mm is not None and not LEAST_PITCH_MM <= length_mm <= LARGEST_PITCH_MM:
        raise UnreadableScan(
            "out-of-range",
            f"{path} is {length_mm:g} mm; a distance between cells must be between {LEAST_PITCH_MM:g} and "
            f"{LARGEST_PITCH_MM:g} mm: correct it, or leave it out",
        )
    return length_mm, () if problem is None else (ReadingMessage.LENGTH_IGNORED(problem, path=path),)


def _read_vector(dataset: h5py.Dataset, path: str) -> NDArray[np.float64]:
    if dataset.size != max(dataset.shape, default=1):
        raise UnreadableScan(
            "wrong-shape", f"{path} has the shape {dataset.shape}; it must be a list of numbers, along one axis"
        )
    return read_values(dataset, np.float64).reshape(-1)
