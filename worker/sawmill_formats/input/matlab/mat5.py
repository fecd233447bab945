"""MATLAB files of version 5 (7.3 is HDF5)."""

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, as_float32, check_number_type, check_size
from sawmill_formats.input.contents import FileContents, Wanted, held
from sawmill_formats.input.matlab.mat5_variables import Variable, list_variables, read_numbers, read_text
from sawmill_formats.input.named_arrays import LONGEST_TEXT, ArrayInfo, NamedArrays, read_named_arrays

MATLAB_NUMBERS = frozenset(
    {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
)


def read_mat5(path: Path, selection: Wanted, bounds: Bounds, _: ExitStack) -> FileContents:
    """Read the variables and fields of structs that are needed, and no others."""
    variables = list_variables(path, bounds.array)
    load = partial(_load, path, variables, bounds)
    arrays = NamedArrays(
        format="mat-v5",
        infos={
            name: ArrayInfo(variable.shape, variable.kind in MATLAB_NUMBERS, variable.kind)
            for name, variable in variables.items()
        },
        load=load,
        projections=lambda name: held(as_float32(load(name))),
        text=partial(_text, path, variables, bounds),
    )
    return read_named_arrays(arrays, selection)


def _load(path: Path, variables: dict[str, Variable], bounds: Bounds, name: str) -> NDArray[Any]:
    variable, where = variables[name], repr(quoted(name))
    check_matlab_class(where, variable.kind)
    check_number_type(where, np.dtype(np.complex128 if variable.is_complex else variable.kind))
    itemsize = np.dtype(variable.kind).itemsize
    check_size(where, variable.shape, itemsize, stored_bytes=variable.stored_bytes, max_bytes=bounds.piece)
    return read_numbers(path, variable, bounds.array)


def check_matlab_class(where: str, kind: str | None) -> None:
    """Refuse variables of MATLAB's classes that are no real numbers: `wrong-type`."""
    if kind is None or kind in MATLAB_NUMBERS:
        return
    fields = ", or name a field of it by its path" if kind == "struct" else ""
    noun = "cell array" if kind == "cell" else quoted(kind)
    raise UnreadableScan("wrong-type", f"{where} is a MATLAB {noun}; a scan is one array of real numbers{fields}")


def _text(path: Path, variables: dict[str, Variable], bounds: Bounds, name: str) -> str | None:
    variable = variables[name]
    if variable.kind != "char" or np.prod(variable.shape, dtype=float) > LONGEST_TEXT:
        return None
    return read_text(path, variable, bounds.array)
