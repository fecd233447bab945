"""Parts of all HDF5 layouts: angles and pixel sizes with units, packed values, and projections in any order of axes."""

import math
import re

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, Scaling
from sawmill_formats.input.contents import (
    LARGEST_PITCH_MM,
    LEAST_PITCH_MM,
    FileAngles,
    FileContents,
    FilePitch,
    Projections,
    Wanted,
    kind_of,
    length_of,
    to_degrees,
    with_similar_fields,
)
from sawmill_formats.input.hdf5.guard import (
    Node,
    attribute,
    attribute_text,
    find,
    members,
    name_of,
    numbers,
    read_images,
    read_values,
    text_of,
)
from sawmill_formats.input.hdf5.storage import check_dataset
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage


def read_angles(start: Node, path: str, bounds: Bounds, *, default_unit: str | None) -> FileAngles:
    """Read angles (n,) float64 in degrees, or the reason why the angles in the file cannot be used."""
    dataset = numbers(start, path, bounds)
    if dataset is None:
        return FileAngles()
    values = _read_vector(dataset, path)
    first = attribute(dataset, "initial_angle")  # as CIL writes it
    values = values + first if isinstance(first, np.floating) else values
    unit = attribute_text(dataset, "units") or attribute_text(dataset, "angle_unit") or default_unit
    if unit is None:
        return FileAngles(unusable=ReadingMessage.ANGLES_WITHOUT_UNIT(path=path))
    angles_deg = to_degrees(values, unit)
    if angles_deg is None:
        return FileAngles(unusable=ReadingMessage.ANGLES_OF_OTHER_UNIT(unit=quoted(unit), path=path))
    return FileAngles(angles_deg, quoted(unit))


def read_pitch(start: Node, path: str, bounds: Bounds) -> FilePitch:
    """Read a pixel size times the binning next to it: `out-of-range` for a size that no detector has."""
    dataset = numbers(start, path, bounds)
    if dataset is None:
        return FilePitch()
    unit = attribute_text(dataset, "units")
    length_mm, problem = length_of(_read_vector(dataset, path), None if unit is None else quoted(unit))
    if length_mm is not None and not LEAST_PITCH_MM <= length_mm <= LARGEST_PITCH_MM:
        raise UnreadableScan(
            "out-of-range",
            f"{path} is {length_mm:g} mm; a distance between cells must be between {LEAST_PITCH_MM:g} and "
            f"{LARGEST_PITCH_MM:g} mm: correct it, or leave it out",
        )
    if length_mm is None:
        return FilePitch(remarks=() if problem is None else (ReadingMessage.LENGTH_IGNORED(problem, path=path),))
    binning_path, binning = _binning(start, path, bounds)
    if binning is None:
        unclear = ReadingMessage.BINNING_UNCLEAR(path=binning_path)
        return FilePitch(remarks=(ReadingMessage.LENGTH_IGNORED(unclear, path=path),))
    if binning == 1:
        return FilePitch(length_mm)
    of_cells = {"path": path, "pixel_mm": f"{length_mm:g}", "pitch_mm": f"{binning * length_mm:g}"}
    remark = ReadingMessage.BINNED(binning_path=binning_path, binning=binning, **of_cells)
    return FilePitch(binning * length_mm, binning, (remark,))


def _binning(start: Node, path: str, bounds: Bounds) -> tuple[str, int | None]:
    """Read how many pixels were read as one along the axis of a pixel size: the place, and None where it is unclear."""
    folder, _, name = path.rpartition("/")
    for candidate in (f"{name[0]}_binning", f"binning_{name[0]}", "binning"):
        place = f"{folder}/{candidate}"
        node = find(start, place, bounds.linked)
        if isinstance(node, h5py.Dataset):
            if node.dtype.kind not in "iuf":
                return place, None
            check_dataset(repr(quoted(place)), node, bounds)
            # Cameras state 0 where they do not bin.
            (binning, *several) = {max(value, 1.0) for value in read_values(node, np.float64).flat} or (math.nan,)
            return place, int(binning) if float(binning).is_integer() and not several else None
    return path, 1


def with_fields_beside(
    contents: FileContents, dataset: h5py.Dataset, bounds: Bounds, selection: Wanted
) -> FileContents:
    """Return contents with the fields that datasets next to the projections are by their names; no link is followed."""
    if not selection.similar:
        return contents
    group = dataset.parent
    hard = (text_of(key) for key, kind in members(group) if kind == h5py.h5l.TYPE_HARD)
    nodes = {name: find(group, name, bounds.linked) for name in hard if kind_of(name) is not None}
    shapes = {name: node.shape or () for name, node in nodes.items() if isinstance(node, h5py.Dataset)}

    def load(name: str) -> NDArray[np.float32]:
        check_dataset(repr(quoted(name)), nodes[name], bounds)
        return read_unpacked(nodes[name])

    return with_similar_fields(contents, shapes, load, selection)


def _read_vector(dataset: h5py.Dataset, path: str) -> NDArray[np.float64]:
    if dataset.size != max(dataset.shape, default=1):
        raise UnreadableScan(
            "wrong-shape", f"{path} has the shape {dataset.shape}; it must be a list of numbers, along one axis"
        )
    return scaling_of(dataset).apply(read_values(dataset, np.float64).reshape(-1))


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
    return scaling_of(dataset).apply(read_values(dataset, np.float32))


def packing_remarks(*datasets: h5py.Dataset | None) -> tuple[Reason, ...]:
    """Return a remark on each dataset whose values are packed."""
    there = (dataset for dataset in datasets if dataset is not None)
    return tuple(remark for each in there for remark in scaling_of(each).remarks(name_of(each).strip("'/")))


def all_views(dataset: h5py.Dataset) -> Projections:
    """Return the projections of a checked dataset (views, rows, detector) or (views, detector)."""
    return chosen_views(dataset, np.arange(len(dataset)))


def chosen_views(dataset: h5py.Dataset, images: NDArray[np.intp]) -> Projections:
    """Return the images with these rising indices of a checked dataset."""
    scaling = scaling_of(dataset)

    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        if dataset.ndim == 2:
            return scaling.apply(read_images(dataset, images[views])[:, np.newaxis])
        return scaling.apply(read_images(dataset, images[views], rows))

    # Sources of a virtual dataset usually are a camera's images, which are read as a whole.
    chunks = (1, *dataset.shape[1:]) if dataset.is_virtual else dataset.chunks or (1, 1)
    return Projections((len(images), *dataset.shape[1:]), read, (chunks[0], chunks[1] if len(chunks) == 3 else 1))


VIEWS = re.compile("angles?|theta|rotation_angle|views?|projections?|frames?|phi", re.IGNORECASE)
ROWS = re.compile("vertical|y|rows?|v", re.IGNORECASE)
CELLS = re.compile("horizontal|x|columns?|cells?|detector|u", re.IGNORECASE)


def stated_order(dataset: h5py.Dataset) -> tuple[int, ...] | None:
    """Return the dataset's axes in the order views, rows, cells; None where that is their order, or none is stated."""
    axes, numbers = (VIEWS, ROWS, CELLS) if dataset.ndim == 3 else (VIEWS, CELLS), range(dataset.ndim)
    is_signal = attribute_text(dataset.parent, "signal") == name_of(dataset).strip("'").rpartition("/")[2]
    candidates: list[list[str | None]] = [
        *([attribute_text(dataset, f"{form}{axis}") for axis in numbers] for form in ("dimension", "dim")),
        [*re.findall(r"\w+", attribute_text(dataset, "axes") or "")],
        np.asarray(attribute(dataset.parent, "axes") if is_signal else ()).astype(str).reshape(-1).tolist(),
    ]
    for names in candidates:
        order = [index for words in axes for index, name in enumerate(names) if words.fullmatch(name or "")]
        if len(names) == dataset.ndim and sorted(order) == [*numbers]:
            return None if order == [*numbers] else tuple(order)
    return None
