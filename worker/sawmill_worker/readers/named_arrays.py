"""Files that are bags of named arrays (NPZ, MAT, HDF5 without a known layout): which one is what."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.files.errors import UnreadableScan, quoted
from sawmill_worker.readers.arrays import as_float32, check_scan_dimensions
from sawmill_worker.readers.contents import FileContents, Projections

PROJECTION_NAMES = ("projections", "sinogram", "data", "arr")
OTHER_NAMES = frozenset({"angles_deg", "angles_rad", "flats", "darks"})
MOST_NAMES_QUOTED = 12


@dataclass(frozen=True)
class ArrayInfo:
    """What is known of an array before it is read."""

    shape: tuple[int, ...]
    numeric: bool


@dataclass(frozen=True)
class NamedArrays:
    """A bag of arrays.

    Attributes
    ----------
    format : str
        What the file turned out to be.
    infos : mapping of name to ArrayInfo
        Every array, in the axis order in which `load` gives it.
    load : function of a name
        Reads one array after having checked its type and its size.
    projections : function of a name
        The same for the projections, which need not be read as a whole.
    """

    format: str
    infos: Mapping[str, ArrayInfo]
    load: Callable[[str], NDArray[Any]]
    projections: Callable[[str], Projections]


def read_named_arrays(arrays: NamedArrays, dataset: str | None, remarks: tuple[str, ...] = ()) -> FileContents:
    """Take the projections (the one named, or the only candidate) and what stands beside them by name.

    Raises
    ------
    UnreadableScan
        `dataset-missing` or `dataset-ambiguous`, or whatever `load` refuses.
    """
    name = _named(arrays.infos, dataset) if dataset is not None else _only_candidate(arrays.infos)
    check_scan_dimensions(repr(quoted(name)), arrays.infos[name].shape)
    return FileContents(
        format=arrays.format,
        projections=arrays.projections(name),
        flats=_optional(arrays, "flats"),
        darks=_optional(arrays, "darks"),
        angles_deg=_angles(arrays),
        remarks=remarks,
    )


def _named(infos: Mapping[str, ArrayInfo], dataset: str) -> str:
    name = dataset.strip("/")
    if name not in infos:
        raise UnreadableScan(
            "dataset-missing", f"the file holds no array named {quoted(dataset)!r}; it holds {_listed(infos)}"
        )
    return name


def _only_candidate(infos: Mapping[str, ArrayInfo]) -> str:
    possible = [name for name, info in infos.items() if name not in OTHER_NAMES and _could_be_projections(info)]
    usual = [name for name in possible if name in PROJECTION_NAMES]
    candidates = usual or possible
    if not candidates:
        raise UnreadableScan(
            "dataset-missing",
            f"the file holds no array of (views, rows, detector) or (views, detector); it holds {_listed(infos)}",
        )
    if len(candidates) > 1:
        raise UnreadableScan(
            "dataset-ambiguous",
            f"several arrays could be the projections ({_listed({name: infos[name] for name in candidates})}); "
            "name the right one with dataset",
        )
    return candidates[0]


def _could_be_projections(info: ArrayInfo) -> bool:
    return info.numeric and len(info.shape) in {2, 3} and info.shape[0] >= 3 and info.shape[-1] >= 2


def _listed(infos: Mapping[str, ArrayInfo]) -> str:
    names = [f"{quoted(name)} {info.shape}" for name, info in infos.items()]
    more = ", ..." if len(names) > MOST_NAMES_QUOTED else ""
    return ", ".join(names[:MOST_NAMES_QUOTED]) + more if names else "no arrays"


def _optional(arrays: NamedArrays, name: str) -> NDArray[np.float32] | None:
    return as_float32(arrays.load(name)) if name in arrays.infos else None


def _angles(arrays: NamedArrays) -> NDArray[np.float64] | None:
    given = [name for name in ("angles_deg", "angles_rad") if name in arrays.infos]
    if not given:
        return None
    if len(given) == 2:
        raise UnreadableScan("contradiction", "the file holds angles_deg and angles_rad; leave one of them out")
    values = np.asarray(arrays.load(given[0]), dtype=np.float64)
    if values.size != max(values.shape, default=1):
        raise UnreadableScan(
            "wrong-shape", f"{given[0]} has the shape {values.shape}; it must be a list with one angle for each view"
        )
    flat = values.reshape(-1)
    return np.rad2deg(flat) if given[0] == "angles_rad" else flat
