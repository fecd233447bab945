"""Angles and pixel sizes, which both HDF5 layouts store with a units attribute, and fields of other names."""

import math

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileAngles, FileContents, FilePitch
from sawmill_formats.input.field_names import kind_of, with_similar_fields
from sawmill_formats.input.hdf5.guard import Node, find, members, numbers, read_values, text_of
from sawmill_formats.input.hdf5.packed_values import read_unpacked, scaling_of
from sawmill_formats.input.hdf5.storage import check_dataset
from sawmill_formats.input.hdf5.texts import attribute, attribute_text
from sawmill_formats.input.units import LARGEST_PITCH_MM, LEAST_PITCH_MM, length_of, to_degrees
from sawmill_formats.input.wanted import Wanted
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
