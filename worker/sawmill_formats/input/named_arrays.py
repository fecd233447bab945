"""Files that are collections of named arrays (NPZ, MAT, HDF5 without a known layout), and the roles of the arrays."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import as_float32, check_scan_dimensions
from sawmill_formats.input.contents import (
    FileAngles,
    FileContents,
    Projections,
    Wanted,
    kind_of,
    to_degrees,
    with_similar_fields,
)
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

PROJECTION_NAMES = ("projections", "sinogram", "data", "arr")
OTHER_NAMES = frozenset({"angles_deg", "angles_rad", "flats", "darks"})
DEVIATIONS = "deviations"
# Roles of arrays by their names, as words that follow the shape; other arrays are described by their shapes.
OF_OTHERS = {"flats": " of flat fields by its name", "darks": " of dark fields by its name"}
MOST_NAMES_QUOTED = 12
LONGEST_TEXT = 20
# Arrays with such a name could be angles, but only a person who knows their meaning and unit can say so.
ANGLES = re.compile("angle|theta", re.IGNORECASE)
LENGTHS = re.compile(
    # Scales and offsets of packed values too, under their whole names.
    "distance|pixel|pitch|spacing|^(data_|projections_)?(scale(_factor)?|scaling_factor|(add_)?offset|slope|intercept)$",
    re.IGNORECASE,
)
# Contents of a cell array lie in this group of a MATLAB 7.3 file.
CELL_CONTENTS = "#refs#/"


@dataclass(frozen=True)
class ArrayInfo:
    """Properties of an array that are known before it is read; `kind` names its type where that is no number.

    `order` has the array's axes in our order, where the file states it.
    """

    shape: tuple[int, ...]
    numeric: bool
    kind: str = ""
    order: tuple[int, ...] | None = None

    def shape_in_order(self, selection: Wanted) -> tuple[int, ...]:
        """Return the shape in our order, or as stored where another number of axes is named."""
        if selection.axes is not None and len(self.shape) != selection.axes.count(",") + 1:
            return self.shape
        order = selection.order(len(self.shape)) or self.order or range(len(self.shape))
        return tuple(self.shape[axis] for axis in order)


@dataclass(frozen=True)
class NamedArrays:
    """A collection of arrays."""

    format: str  # format of the file
    infos: Mapping[str, ArrayInfo]  # every array, in the axis order in which `load` gives it
    load: Callable[[str], NDArray[Any]]  # reads one array after having checked its type and its size
    projections: Callable[[str], Projections]
    text: Callable[[str], str | None] = lambda _: None  # reads a short text; None where the array is none
    remarks: Callable[[str], tuple[Reason, ...]] = lambda _: ()  # remarks on how an array is read
    stated_angles: Callable[[str], FileAngles] = lambda _: FileAngles()


def read_named_arrays(arrays: NamedArrays, selection: Wanted, remarks: tuple[Reason, ...] = ()) -> FileContents:
    """Read the projections, by name or the only candidate, and arrays next to them: `dataset-missing`."""
    name = (
        _named(arrays.infos, selection.dataset)
        if selection.dataset is not None
        else _only_candidate(arrays.infos, selection)
    )
    shape = arrays.infos[name].shape
    check_scan_dimensions(repr(quoted(name)), shape)
    if selection.fields is not None:
        return FileContents(
            format=arrays.format, projections=arrays.projections(name), remarks=(*remarks, *arrays.remarks(name))
        )
    order = selection.order(len(shape)) or arrays.infos[name].order
    angles = _angles(arrays)
    angles = angles if angles.deg is not None else arrays.stated_angles(name)
    views, *others = arrays.infos[name].shape_in_order(selection)
    lists = [] if angles.deg is not None else _could_serve(arrays, name, ANGLES, views)
    possible_angles = None
    if not lists and angles.deg is None and order is None:
        of_axes = [(axis, _could_serve(arrays, name, ANGLES, size)) for axis, size in enumerate(others, 1) if size > 2]
        possible_angles = next(((axis, ", ".join(named)) for axis, named in reversed(of_axes) if named), None)
    values = _could_serve(arrays, name, LENGTHS, 1)
    unused = ", ".join(values) if values else None
    used = [name, *(other for other in (*OTHER_NAMES, DEVIATIONS) if other in arrays.infos)]
    contents = FileContents(
        format=arrays.format,
        projections=arrays.projections(name),
        flats=_optional(arrays, "flats"),
        darks=_optional(arrays, "darks"),
        deviations=_optional(arrays, DEVIATIONS) if selection.deviations else None,
        angles=FileAngles(unusable=ReadingMessage.ANGLES_UNNAMED(arrays=", ".join(lists))) if lists else angles,
        angles_of_axis=possible_angles,
        order=order,
        unused=unused,
        remarks=(
            *remarks,
            *(remark for each in used for remark in arrays.remarks(each)),
            *(() if unused is None else (ReadingMessage.UNUSED_VALUES(arrays=unused),)),
        ),
    )
    shapes = {other: info.shape for other, info in arrays.infos.items() if info.numeric and other != name}
    return with_similar_fields(contents, shapes, lambda other: as_float32(arrays.load(other)), selection)


def _named(infos: Mapping[str, ArrayInfo], dataset: str) -> str:
    name = dataset.strip("/")
    if name not in infos:
        raise UnreadableScan(
            "dataset-missing", f"the file holds no array named {quoted(dataset)!r}; it holds {_listed(infos)}"
        )
    return name


def _only_candidate(infos: Mapping[str, ArrayInfo], selection: Wanted) -> str:
    if selection.fields is not None and selection.fields in infos:
        return selection.fields
    reserved_names = OTHER_NAMES | {DEVIATIONS} if selection.deviations else OTHER_NAMES
    in_order = {name: replace(info, shape=info.shape_in_order(selection)) for name, info in infos.items()}
    possible = [
        name
        for name, info in in_order.items()
        if name not in reserved_names and not _unfit(info, selection.least_images)
    ]
    usual = [name for name in possible if name in PROJECTION_NAMES]
    candidates = usual or [name for name in possible if kind_of(name) is selection.fields] or possible
    if not candidates or len(candidates) == len([name for name in candidates if name.startswith(CELL_CONTENTS)]) > 1:
        outside = {name: info for name, info in infos.items() if not name.startswith(CELL_CONTENTS)}
        raise UnreadableScan(
            "dataset-missing",
            "the file holds no array of (views, rows, detector) or (views, detector); it holds "
            f"{_listed(outside, reasons=True)}",
        )
    if len(candidates) > 1:
        raise UnreadableScan(
            "dataset-ambiguous",
            f"several arrays could be the projections ({_listed({name: infos[name] for name in candidates})}); "
            "name the right one with dataset",
        )
    return candidates[0]


def _unfit(info: ArrayInfo, least_views: int) -> str:
    """Return why an array cannot be projections, as words that follow its shape."""
    if info.kind == "cell":
        return ", a cell array: store one array of numbers instead"
    if not info.numeric:
        return f" of {info.kind or 'something else'}, not of real numbers"
    if len(info.shape) not in {2, 3}:
        return f" with {len(info.shape)} axes instead of 2 or 3"
    if info.shape[0] < least_views:
        return f" with {info.shape[0]} views, at least {least_views} are needed"
    return f" with {info.shape[-1]} cells, at least 2 are needed" if info.shape[-1] < 2 else ""


def _listed(infos: Mapping[str, ArrayInfo], *, reasons: bool = False) -> str:
    names = [
        f"{quoted(name)} {info.shape}{(OF_OTHERS.get(name) or _unfit(info, 3)) if reasons else ''}"
        for name, info in islice(infos.items(), MOST_NAMES_QUOTED + 1)
    ]
    more = ", ..." if len(names) > MOST_NAMES_QUOTED else ""
    return ", ".join(names[:MOST_NAMES_QUOTED]) + more if names else "no arrays"


def _optional(arrays: NamedArrays, name: str) -> NDArray[np.float32] | None:
    return as_float32(arrays.load(name)) if name in arrays.infos else None


def _angles(arrays: NamedArrays) -> FileAngles:
    angle_names = [name for name in ("angles_deg", "angles_rad") if name in arrays.infos]
    if not angle_names:
        return FileAngles()
    if len(angle_names) == 2:
        raise UnreadableScan("contradiction", "the file holds angles_deg and angles_rad; leave one of them out")
    values = np.asarray(arrays.load(angle_names[0]), dtype=np.float64)
    if values.size != max(values.shape, default=1):
        raise UnreadableScan(
            "wrong-shape",
            f"{angle_names[0]} has the shape {values.shape}; it must be a list with one angle for each view",
        )
    unit = angle_names[0].removeprefix("angles_")
    return FileAngles(to_degrees(values.reshape(-1), unit), unit)


def _could_serve(arrays: NamedArrays, projections: str, pattern: re.Pattern[str], size: int) -> list[str]:
    """Name the arrays with such a name that are texts or have `size` values, with their uninterpreted values."""
    infos = ((name, info) for name, info in arrays.infos.items() if name not in {projections, *OTHER_NAMES})
    named = ((name, info) for name, info in infos if pattern.search(name.rpartition("/")[2]))
    described = (_described(arrays, name) for name, info in named if not info.numeric or math.prod(info.shape) == size)
    return list(islice(filter(None, described), MOST_NAMES_QUOTED))


def _described(arrays: NamedArrays, name: str) -> str | None:
    if not arrays.infos[name].numeric:
        text = arrays.text(name)
        return None if text is None else f"{quoted(name)} ({quoted(text)!r})"
    values = np.asarray(arrays.load(name), np.float64).reshape(-1)
    if values.size == 1:
        return f"{quoted(name)} ({values[0]:.7g})"
    return f"{quoted(name)} ({values.size} values from {values[0]:g} to {values[-1]:g})"
