"""Contents of a file and its parts, before they are compared with parameters; fields and units by their names."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_vocabulary import DetectorModule
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

AXES = ("views", "rows", "cells")


class FieldKind(StrEnum):
    """Kinds of fields that counts are compared with: air, and the detector without a beam."""

    FLATS = "flats"
    DARKS = "darks"


@dataclass(frozen=True)
class Wanted:
    """Arrays of a file that a reader reads."""

    dataset: str | None = None  # path or name, where the file holds several arrays; None for the only candidate
    fields: FieldKind | None = None  # fields in a file of their own
    deviations: bool = False  # whether the file may hold the projections' standard deviations
    transpose: bool = False  # whether the file has the axes in reverse order; readers give them as they are stored
    apart: frozenset[Path] = frozenset()  # files of a folder that are read apart, as fields
    axes: str | None = None  # names of the file's axes in their order, as an alternative to `transpose`
    similar: frozenset[FieldKind] = frozenset()
    turns: bool = True  # False: the images are passages, of which one is enough

    @property
    def least_images(self) -> int:
        """Fewest images that can be meant."""
        return 3 if self.turns and not self.fields else 1

    def order(self, dimensions: int) -> tuple[int, ...] | None:
        """Return the file's axes in our order, or None where no order is given: `contradiction` for other axes."""
        if self.axes is None:
            return tuple(reversed(range(dimensions))) if self.transpose else None
        ours, names = AXES if dimensions == 3 else AXES[::2], self.axes.split(",")
        if self.transpose or sorted(names) != sorted(ours):
            raise UnreadableScan(
                "contradiction",
                f"axes is {quoted(self.axes)!r}; it must name {', '.join(ours)}, one for each axis of the projections, "
                "in the order of the file, and goes without transpose",
            )
        return tuple(names.index(name) for name in ours)


ReadBlock = Callable[[slice, slice], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Projections:
    """The projections of an open file, read block by block."""

    shape: tuple[int, ...]  # (views, rows, detector) or (views, detector): shape as stored
    # Reads a slice of views and one of rows (the one row of a sinogram), each with start and stop inside the shape:
    # (views, rows, detector) float32, contiguous and the caller's own
    read: ReadBlock
    # (views, rows): size of what the file stores in one piece: blocks of whole pieces read each once
    together: tuple[int, int]


def held(array: NDArray[np.float32]) -> Projections:
    """Return projections (views, rows, detector) or (views, detector) that are in memory as a whole."""
    stack = array[:, np.newaxis, :] if array.ndim == 2 else array
    return Projections(array.shape, lambda views, rows: stack[views, rows].copy(), (1, 1))


def in_order(stored: Projections, order: tuple[int, ...]) -> Projections:
    """Return projections of a file whose axes have another order; `order` has the file's axes in ours."""
    shape = tuple(stored.shape[axis] for axis in order)
    # A sinogram is read as a stack of one row, whose axis is the middle one.
    axes = order if len(order) == 3 else (2 * order[0], 1, 2 * order[1])
    together = (*stored.together, stored.shape[-1])

    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        parts = dict(zip(axes, (views, rows, slice(0, shape[-1])), strict=True))
        return np.ascontiguousarray(stored.read(parts[0], parts[1])[..., parts[2]].transpose(axes))

    return Projections(shape, read, (together[axes[0]], together[axes[1]]))


def named_axes(order: tuple[int, ...]) -> str:
    """Name the axes of a file in its own order."""
    names = AXES if len(order) == 3 else AXES[::2]
    return ",".join(names[order.index(axis)] for axis in range(len(order)))


def axes_of_fields(dimensions: int, order: tuple[int, ...]) -> tuple[int, ...]:
    """Return the axes of fields in our order: as many as the projections have, or without the views' for one field."""
    if dimensions == len(order):
        return order
    others = order[1:]
    return tuple(sorted(others).index(axis) for axis in others) if dimensions == len(others) else ()


def fields_in_order(
    fields: NDArray[np.float32] | None, order: tuple[int, ...], shape: tuple[int, ...]
) -> NDArray[np.float32] | None:
    """Return fields of a file with the axes of projections of this shape; fields that fit as they are stay so."""
    if fields is None or not (axes := axes_of_fields(fields.ndim, order)):
        return fields
    ordered = np.ascontiguousarray(fields.transpose(axes))
    return fields if (fields.shape[1 - len(shape) :] == shape[1:] != ordered.shape[1 - len(shape) :]) else ordered


@dataclass(frozen=True, eq=False)
class FileAngles:
    """The angles (n,) float64 that a file carries, in degrees, their unit in the file, and why they cannot be used."""

    deg: NDArray[np.float64] | None = None
    unit: str | None = None
    unusable: Reason | None = None


@dataclass(frozen=True)
class FilePitch:
    """The distance between cells or rows that a file carries, in mm, and the binning in it; remarks on both."""

    mm: float | None = None
    binning: int = 1
    remarks: tuple[Reason, ...] = ()


@dataclass(frozen=True, eq=False)
class FileContents:
    """The reading of one file."""

    format: str  # format of the file
    projections: Projections  # as stored: counts or line integrals, which no file states reliably
    flats: NDArray[np.float32] | None = None
    darks: NDArray[np.float32] | None = None
    deviations: NDArray[np.float32] | None = None  # their standard deviations
    angles: FileAngles = FileAngles()  # the views' angles
    # (int, str) or None: another axis than the views', with the arrays that could be angles by their names and have its
    # length
    angles_of_axis: tuple[int, str] | None = None
    order: tuple[int, ...] | None = None  # the file's axes in our order, where the file states it or it was given
    # Arrays that could be fields by their names, where it is not clear which
    possible_fields: Mapping[FieldKind, str] = field(default_factory=dict)
    pitch: FilePitch = FilePitch()  # distance between cells and between rows
    row_pitch: FilePitch = FilePitch()
    detector_modules: tuple[DetectorModule, ...] = ()  # modules of the detector after the first
    detector_arc_radius_mm: float | None = None  # radius of the arc on which the cells lie
    # Values that could serve as pitch or distance, where the file does not state what they are
    unused: str | None = None
    remarks: tuple[Reason, ...] = ()  # changes that were made to the data, and what the file lacks
    others: tuple[Path, ...] = ()  # further files that were read: of the fields, in a folder, behind links


MOST_NAMES = 12
_TIMES = "pre|post|before|after"
_WITH = f"(fields?|frames?|images?|beams?|currents?|{_TIMES})?s?"
KINDS = {
    FieldKind.FLATS: re.compile(f"(flat|white|bright|open|ob|ff|i[o0]|air){_WITH}"),
    FieldKind.DARKS: re.compile(f"(dark|offset|bias|di|df){_WITH}"),
}
TIMES = re.compile(f"{_TIMES}|start|end|begin")
# Words next to them. With any other word an array is something else, such as `flat_corrected`.
OTHER_WORDS = re.compile(
    f"{TIMES.pattern}|data|fields?|frames?|images?|imgs?|beam|current|mean|avg|average|median|ref(erences?)?|"
    "proj(ections?)?|stack|array|raw"
)


def words_of(name: str) -> list[str]:
    """Return the words of a name in small letters, also of one as FlatField01."""
    return re.findall("i0|[a-z]+", re.sub("(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower())


def kinds_in(words: Iterable[str]) -> dict[str, FieldKind]:
    """Select the words that name fields, with their kinds."""
    return {word: kind for word in words for kind, pattern in KINDS.items() if pattern.fullmatch(word)}


def kind_of(name: str) -> FieldKind | None:
    """Return the kind of fields that an array has by its name, or by its group's where its own states none."""
    for part in reversed(name.split("/")[-2:]):
        words = words_of(part)
        kinds = kinds_in(words)
        others = not all(word in kinds or OTHER_WORDS.fullmatch(word) for word in words)
        if kinds or others:
            (kind, *several) = {*kinds.values()} or (None,)
            return None if others or several else kind
    return None


def with_similar_fields(
    contents: FileContents,
    shapes: Mapping[str, tuple[int, ...]],
    load: Callable[[str], NDArray[np.float32]],
    selection: Wanted,
) -> FileContents:
    """Return contents with the fields that arrays of these shapes are by their names, where the usual names lack."""
    order = contents.order or tuple(range(len(contents.projections.shape)))
    of_view = tuple(contents.projections.shape[axis] for axis in order[1:])
    fields, possible, remarks = {FieldKind.FLATS: contents.flats, FieldKind.DARKS: contents.darks}, {}, []
    for kind in (kind for kind, images in fields.items() if images is None and kind in selection.similar):
        named = [name for name, shape in shapes.items() if math.prod(shape) > 1 and kind_of(name) is kind]
        fitting = [name for name in named if _fits(shapes[name], order, of_view)]
        several = fitting or named
        listed = ", ".join(f"{quoted(name)} {shapes[name]}" for name in several[:MOST_NAMES])
        listed += ", ..." if len(several) > MOST_NAMES else ""
        # Fields before and after a scan are of one kind; of others it is not clear which are meant.
        stems = {tuple(word for word in words_of(name) if not TIMES.fullmatch(word)) for name in fitting}
        if len(stems) == 1 and (len(fitting) == 1 or contents.order is None):
            images = [load(name) for name in fitting]
            fields[kind] = np.concatenate([each.reshape(-1, *of_view) for each in images]) if images[1:] else images[0]
            taken = ReadingMessage.FLATS_BY_NAME if kind is FieldKind.FLATS else ReadingMessage.DARKS_BY_NAME
            remarks.append(taken(arrays=listed))
        elif named:
            possible[kind] = listed
    return replace(
        contents,
        flats=fields[FieldKind.FLATS],
        darks=fields[FieldKind.DARKS],
        possible_fields=possible,
        remarks=(*contents.remarks, *remarks),
    )


def _fits(shape: tuple[int, ...], order: tuple[int, ...], of_view: tuple[int, ...]) -> bool:
    """Return whether fields of this shape have the rows and cells of the views, as stored or in our order."""
    axes = axes_of_fields(len(shape), order)
    return bool(axes) and of_view in {shape[-len(of_view) :], tuple(shape[axis] for axis in axes)[-len(of_view) :]}


# The micro sign, and the Greek letter.
_MICRONS = "um \u00b5m \u03bcm micron microns micrometer micrometers micrometre micrometres"
_UNITS_MM = {
    "nm nanometer nanometers nanometre nanometres": 1e-6,
    _MICRONS: 1e-3,
    "mm millimeter millimeters millimetre millimetres": 1.0,
    "cm centimeter centimeters centimetre centimetres": 10.0,
    "in inch inches": 25.4,
    "m meter meters metre metres": 1000.0,
}
LENGTHS_MM = {name: mm for names, mm in _UNITS_MM.items() for name in names.split()}
DEGREES = {"deg", "degree", "degrees", "°"}
RADIANS = {"rad", "radian", "radians"}
# Distances between cells, in mm: from a nanometre to a metre.
LEAST_PITCH_MM, LARGEST_PITCH_MM = 1e-6, 1000.0


def to_mm(value: float, unit: str) -> float | None:
    """Convert a length to mm; None for a unit that is not one of length."""
    factor = LENGTHS_MM.get(unit.strip().lower())
    return None if factor is None else value * factor


def to_degrees(values: NDArray[np.float64], unit: str) -> NDArray[np.float64] | None:
    """Convert angles to degrees; None for a unit that is not one of angle."""
    name = unit.strip().lower()
    if name in DEGREES:
        return values
    with np.errstate(over="ignore"):  # values that become infinite are refused with their place
        return np.rad2deg(values) if name in RADIANS else None


def length_of(values: NDArray[np.float64], unit: str | None) -> tuple[float | None, Reason | None]:
    """Return one length in mm, or None and the reason why it cannot be used."""
    if values.size != 1:
        return None, ReadingMessage.LENGTH_OF_SEVERAL(values=values.size)
    if unit is None:
        return None, ReadingMessage.LENGTH_WITHOUT_UNIT()
    length_mm = to_mm(float(values.reshape(-1)[0]), unit)
    if length_mm is None:
        return None, ReadingMessage.LENGTH_OF_OTHER_UNIT(unit=unit)
    if length_mm == 0.0 or np.isnan(length_mm):
        # Exporters write such a size where they do not know it.
        return None, ReadingMessage.LENGTH_STATES_NOTHING(length_mm=f"{length_mm:g}")
    return length_mm, None


class PartKind(StrEnum):
    """Names of parts in their format."""

    GROUP = "group"
    DATASET = "dataset"
    LINK = "link"
    VARIABLE = "variable"
    ARRAY = "array"
    PAGE = "page"
    FILE = "file"
    PICTURE = "picture"


@dataclass(frozen=True)
class Part:
    """A part as its header describes it."""

    name: str  # path in the file; for several similar parts, the first and the last
    kind: PartKind
    shape: tuple[int, ...] | None = None  # shape in the axis order of the file
    type: str | None = None  # type of the numbers, or what the part is instead
    unit: str | None = None  # unit as in the file
    stored_bytes: int | None = None  # bytes in the file; for several similar parts, of all of them
    compression: str | None = None  # the filters through which it is stored
    leads_to: str | None = None  # target of a link, or place of data in another file
    count: int = 1  # the number of parts, which are alike but for their numbers


def alike_together(parts: Iterable[Part]) -> Iterator[Part]:
    """Combine successive parts that differ only in the numbers in their names and in their bytes."""
    run: list[Part] = []
    for part in parts:
        if run and _form(run[0]) != _form(part):
            yield _as_one(run)
            run = []
        run.append(part)
    if run:
        yield _as_one(run)


def _form(part: Part) -> Part:
    return replace(part, name=re.sub(r"\d+", "#", part.name), stored_bytes=None)


def _as_one(run: list[Part]) -> Part:
    first, last = run[0], run[-1]
    if len(run) == 1:
        return first
    name = f"{first.name} to {last.name.rpartition('/')[2]}"
    return replace(first, name=name, count=len(run), stored_bytes=sum(part.stored_bytes or 0 for part in run) or None)
