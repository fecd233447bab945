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
    """A scale and an offset, and the names of the attributes that state them; none where values are not packed."""

    names: tuple[str, ...] = ()
    scale: float = 1.0
    offset: float = 0.0

    def unpack(self, values: NDArray[Float]) -> NDArray[Float]:
        """Make values of stored numbers, in place."""
        if self.names:
            values *= self.scale
            values += self.offset
        return values


def packing_of(dataset: h5py.Dataset) -> Packing:
    """Return how a dataset's values are packed.

    Raises
    ------
    UnreadableScan
        `contradiction`: attributes state a scale or an offset that cannot be applied.
    """
    packings = [packing for pair in PAIRS if (packing := _stated(dataset, pair)).names]
    if len(packings) > 1 or not all(np.isfinite([each.scale, each.offset]).all() and each.scale for each in packings):
        raise UnreadableScan(
            "contradiction",
            f"the numbers of {name_of(dataset)} seem to be packed, and its attributes "
            f"{', '.join(name for each in packings for name in each.names)} do not state how: write scale_factor and "
            "add_offset as one number each, or write the values themselves without such attributes",
        )
    return packings[0] if packings else Packing()


def _stated(dataset: h5py.Dataset, pair: tuple[str, str]) -> Packing:
    """Return what a pair of attributes states: not a number where that is no number."""
    by_cil = CIL_WRITER in str(attribute(dataset.file, "creator"))
    if pair == CIL and not (by_cil or dataset.dtype.kind in "iu"):  # packed values are integers
        return Packing()
    stated, names = [1.0, 0.0], []
    for index, name in enumerate(pair):
        value = np.asarray(attribute(dataset, name) if name in dataset.attrs else stated[index])
        is_number = value.size == 1 and value.dtype.kind in "iuf"
        # Of CIL's names, anything else than a number is of another program.
        number = float(value.item()) if is_number else stated[index] if pair == CIL else np.nan
        if number != stated[index]:
            stated[index] = number
            names.append(name)
    scale, offset = stated
    if names and pair == CIL:
        scale, offset = (1.0 / scale, -offset / scale) if by_cil and scale else (np.nan, np.nan)
    return Packing(tuple(names), scale, offset)


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
