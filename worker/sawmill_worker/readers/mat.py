"""MATLAB files of version 5 (7.3 is HDF5)."""

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

from sawmill_worker.files.errors import UnreadableScan, quoted
from sawmill_worker.readers.arrays import Bounds, as_float32, check_number_type, check_size
from sawmill_worker.readers.contents import FileContents, held
from sawmill_worker.readers.named_arrays import ArrayInfo, NamedArrays, read_named_arrays

MATLAB_NUMBERS = frozenset(
    {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
)


def read_mat5(path: Path, dataset: str | None, bounds: Bounds, _: ExitStack) -> FileContents:
    """Read the variables that are needed, and no others.

    Raises
    ------
    UnreadableScan
        When the file holds no projections, or they must not be read.
    """
    classes: dict[str, tuple[tuple[int, ...], str]] = {
        name: (tuple(int(n) for n in shape), kind) for name, shape, kind in scipy.io.whosmat(str(path), appendmat=False)
    }
    load = partial(_load, path, classes, bounds.piece)
    arrays = NamedArrays(
        format="mat-v5",
        infos={name: ArrayInfo(shape, kind in MATLAB_NUMBERS) for name, (shape, kind) in classes.items()},
        load=load,
        projections=lambda name: held(as_float32(load(name))),
    )
    return read_named_arrays(arrays, dataset)


def _load(path: Path, classes: dict[str, tuple[tuple[int, ...], str]], max_bytes: int, name: str) -> NDArray[Any]:
    shape, kind = classes[name]
    where = repr(quoted(name))
    if kind not in MATLAB_NUMBERS:
        raise UnreadableScan("wrong-type", f"{where} is a MATLAB {quoted(kind)}; a scan is an array of real numbers")
    check_size(where, shape, np.dtype(kind).itemsize, stored_bytes=path.stat().st_size, max_bytes=max_bytes)
    values = np.asarray(scipy.io.loadmat(str(path), appendmat=False, variable_names=[name])[name])
    check_number_type(where, values.dtype)
    return values
