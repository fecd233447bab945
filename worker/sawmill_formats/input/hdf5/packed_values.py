"""Values that an HDF5 dataset stores packed: as numbers with a scale and an offset in the dataset's attributes."""

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.hdf5.guard import name_of, read_float32
from sawmill_formats.input.hdf5.texts import attribute
from sawmill_formats.input.scaling import Scaling
from sawmill_vocabulary.messages import Reason

# Values are the stored numbers times the scale, plus the offset: CF conventions 1.11, 8.1. CIL's NEXUSDataWriter stores
# value * scale + offset; from another writer this pair may mean anything.
CIL, CIL_WRITER = ("scale", "offset"), "NEXUSDataWriter"
OTHERS = (("slope", "intercept"), ("RescaleSlope", "RescaleIntercept"), ("scaling_factor", "scaling_offset"))
PAIRS = (("scale_factor", "add_offset"), *OTHERS, CIL)
NEUTRAL = {name: number for pair in PAIRS for name, number in zip(pair, (1.0, 0.0), strict=True)}


def scaling_of(dataset: h5py.Dataset) -> Scaling:
    """Return how values are packed: `contradiction` for attributes that cannot be applied."""
    by_cil = CIL_WRITER in str(attribute(dataset.file, "creator"))
    numbers = {name: _number(dataset, name) for name in NEUTRAL if name in dataset.attrs}
    # Packed values are integers, and CIL's names are of something else in other files.
    of_others = not by_cil and (dataset.dtype.kind == "f" or any(np.isnan(numbers.get(name, 0.0)) for name in CIL))
    stated = {n: number for n, number in numbers.items() if number != NEUTRAL[n] and not (of_others and n in CIL)}
    if not stated:
        return Scaling()
    names, pair = ", ".join(stated), next((pair for pair in PAIRS if stated.keys() <= {*pair}), CIL)
    scale, offset = (stated.get(name, NEUTRAL[name]) for name in pair)
    scaling = Scaling.of(names, scale, offset, inverse=pair == CIL) if by_cil or pair != CIL else None
    if scaling is None:
        raise UnreadableScan(
            "contradiction",
            f"the numbers of {name_of(dataset)} seem to be packed, and its attributes {names} do not state how: write "
            "scale_factor and add_offset as one number each, or the values themselves without attributes",
        )
    return scaling


def _number(dataset: h5py.Dataset, name: str) -> float:
    value = np.asarray(attribute(dataset, name))
    return float(value.item()) if value.size == 1 and value.dtype.kind in "iuf" else np.nan


def read_unpacked(dataset: h5py.Dataset) -> NDArray[np.float32]:
    """Read the values of a checked dataset as float32."""
    return scaling_of(dataset).apply(read_float32(dataset))


def packing_remarks(*datasets: h5py.Dataset | None) -> tuple[Reason, ...]:
    """Return a remark on each dataset whose values are packed."""
    there = (dataset for dataset in datasets if dataset is not None)
    return tuple(remark for each in there for remark in scaling_of(each).remarks(name_of(each).strip("'/")))
