"""Flat and dark fields and units, by names as other programs write them."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import quoted
from sawmill_formats.input.contents import FieldKind, FileContents, Wanted, axes_of_fields
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

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
