"""Values that an HDF5 dataset stores packed: as numbers with a scale and an offset in the dataset's attributes."""

from dataclasses import dataclass
from typing import TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.hdf5.guard import name_of, read_float32
from sawmill_formats.input.hdf5.texts import attribute
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

# Values are the stored numbers times the scale, plus the offset: CF conventions 1.11, 8.1; DICOM PS3.3, C.11.1; NeXus
# NXdata. CIL's NEXUSDataWriter stores value * scale + offset; from another writer this pair may mean anything.
CIL, CIL_WRITER = ("scale", "offset"), "NEXUSDataWriter"
PAIRS = (
    ("scale_factor", "add_offset"),
    ("slope", "intercept"),
    ("RescaleSlope", "RescaleIntercept"),
    ("scaling_factor", "scaling_offset"),
    CIL,
)

Float = TypeVar("Float", np.float32, np.float64)


@dataclass(frozen=True)
class Packing:
    """A scale and an offset, the stored number of missing values, and the attributes that state the first two."""

    names: tuple[str, ...]
    scale: float
    offset: float
    missing: float

    def unpack(self, values: NDArray[Float]) -> NDArray[Float]:
        """Make values of stored numbers, in place; missing ones become NaN."""
        if self.names:
            values[values == self.missing] = np.nan
            values *= self.scale
            values += self.offset
        return values


def packing_of(dataset: h5py.Dataset) -> Packing:
    """Return how a dataset's values are packed, without names where they are not.

    Raises
    ------
    UnreadableScan
        `contradiction`: attributes state a scale or an offset that cannot be applied.
    """
    by_cil = CIL_WRITER in str(attribute(dataset.file, "creator"))
    neutral = {name: number for pair in PAIRS for name, number in zip(pair, (1.0, 0.0), strict=True)}
    stated = {name: _number(dataset, name) for name in neutral if name in dataset.attrs}
    stated = {name: number for name, number in stated.items() if number != neutral[name]}
    if not by_cil and (dataset.dtype.kind == "f" or any(np.isnan(stated.get(name, 0.0)) for name in CIL)):
        # Packed values are integers, and CIL's names are of something else in other files.
        stated = {name: number for name, number in stated.items() if name not in CIL}
    pair = next((pair for pair in PAIRS if stated.keys() <= {*pair}), None)
    scale, offset = (stated.get(name, neutral[name]) for name in pair) if pair else (np.nan, np.nan)
    if stated and pair == CIL:
        scale, offset = (1.0 / scale, -offset / scale) if by_cil and scale else (np.nan, np.nan)
    if not (np.isfinite([scale, offset]).all() and scale):
        raise UnreadableScan(
            "contradiction",
            f"the numbers of {name_of(dataset)} seem to be packed, and its attributes {', '.join(stated)} do not state "
            "how: write scale_factor and add_offset as one number each, or the values themselves without attributes",
        )
    return Packing(tuple(stated), scale, offset, _number(dataset, "_FillValue"))


def _number(dataset: h5py.Dataset, name: str) -> float:
    value = np.asarray(attribute(dataset, name))
    return float(value.item()) if value.size == 1 and value.dtype.kind in "iuf" else np.nan


def read_unpacked(dataset: h5py.Dataset) -> NDArray[np.float32]:
    """Read the values of a checked dataset as float32."""
    return packing_of(dataset).unpack(read_float32(dataset))


def packing_remarks(*datasets: h5py.Dataset | None) -> tuple[Reason, ...]:
    """Return a remark on each dataset whose values are packed."""
    packings = ((dataset, packing_of(dataset)) for dataset in datasets if dataset is not None)
    return tuple(
        ReadingMessage.UNPACKED(
            path=name_of(dataset).strip("'/"),
            names=", ".join(packing.names),
            scale=f"{packing.scale:g}",
            offset=f"{packing.offset:g}",
        )
        for dataset, packing in packings
        if packing.names
    )
