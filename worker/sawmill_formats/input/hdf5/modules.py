"""Reading of the modules of a line detector from NXtomo (`sawmill_formats.detector_modules` has the layout)."""

from itertools import islice

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.detector_modules import (
    CLASS,
    MOST_MODULES,
    OFFSET,
    ORIGIN,
    SIZE,
    STEP,
    ModulesUnusable,
    PlacedModule,
    Vector,
    modules_after_first,
    translation,
)
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.hdf5.guard import find, members, numbers, read_values, text_of
from sawmill_formats.input.hdf5.texts import attribute, attribute_text
from sawmill_formats.input.units import to_mm
from sawmill_formats.nxtomo import DETECTOR
from sawmill_vocabulary import DetectorModule
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage


def read_modules(
    entry: h5py.Group, cells: int, pitch_mm: float | None, bounds: Bounds
) -> tuple[tuple[DetectorModule, ...], tuple[Reason, ...]]:
    """Read the modules after the first, and the remark why they were ignored."""
    detector = find(entry, DETECTOR, bounds.linked)
    if not isinstance(detector, h5py.Group):
        return (), ()
    # Of links elsewhere none is followed here: the detector's group may have any, to what is not read.
    hard = (text_of(key) for key, kind in members(detector) if kind == h5py.h5l.TYPE_HARD)
    nodes = (find(detector, name, bounds.linked) for name in hard)
    modules = (node for node in nodes if isinstance(node, h5py.Group) and attribute_text(node, "NX_class") == CLASS)
    groups = list(islice(modules, MOST_MODULES + 1))
    if not groups:
        return (), ()
    try:
        return modules_after_first([_placed(group, bounds) for group in groups], cells, pitch_mm), ()
    except ModulesUnusable as why:
        return (), (ReadingMessage.MODULES_IGNORED(path=DETECTOR, why=str(why)),)


def _placed(group: h5py.Group, bounds: Bounds) -> PlacedModule:
    # Of the cells of a module, of the axes of an image, the last one is along the line.
    first, cells = (float(_numbers_at(group, name, bounds)[1][-1]) for name in (ORIGIN, SIZE))
    if not (first.is_integer() and cells.is_integer() and first >= 0.0 and cells >= 1.0):
        raise ModulesUnusable(f"one begins at cell {first:g} and has {cells:g} cells")
    return PlacedModule(int(first), int(cells), *(_translation(group, name, bounds) for name in (OFFSET, STEP)))


def _numbers_at(group: h5py.Group, name: str, bounds: Bounds) -> tuple[h5py.Dataset, NDArray[np.float64]]:
    dataset = numbers(group, name, bounds.whole)
    if dataset is None or not 1 <= dataset.size <= 3:
        raise ModulesUnusable(f"one has no {name} of one to three numbers")
    values = read_values(dataset, np.float64).reshape(-1)
    if not np.isfinite(values).all():
        raise ModulesUnusable(f"the {name} of one is no finite number")
    return dataset, values


def _translation(group: h5py.Group, name: str, bounds: Bounds) -> Vector:
    """Read a length along its vector, mm."""
    dataset, values = _numbers_at(group, name, bounds)
    length_mm = to_mm(float(values[0]), attribute_text(dataset, "units") or "")
    if length_mm is None:
        raise ModulesUnusable(f"the {name} of one is no length with a unit, along a vector")
    return translation(length_mm, attribute(dataset, "vector"), name)
