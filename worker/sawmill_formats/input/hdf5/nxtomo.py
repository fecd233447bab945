"""HDF5 in the NXtomo layout: images with an image key and an angle for each, and a line detector's modules."""

import math
from dataclasses import replace
from itertools import islice

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats import nxtomo
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
from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, LinkedFiles, check_scan_dimensions, check_size
from sawmill_formats.input.contents import FileAngles, FileContents, Wanted, length_of, to_mm
from sawmill_formats.input.hdf5 import fields, guard
from sawmill_vocabulary import LARGEST_MM, DetectorModule
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage


def find_entries(file: h5py.File, linked: LinkedFiles | None = None) -> list[h5py.Group]:
    """Find every group, at the top or one level below it, whose `definition` is NXtomo."""
    top = [node for _, node in guard.children(file["/"], linked) if isinstance(node, h5py.Group)]
    guard.check_members(sum(map(len, top)))
    below = [node for group in top if not _is_nxtomo(group, linked) for _, node in guard.children(group, linked)]
    return [group for group in (*top, *below) if _is_nxtomo(group, linked)]


def _is_nxtomo(node: guard.Node, linked: LinkedFiles | None) -> bool:
    return isinstance(node, h5py.Group) and guard.read_text(node, "definition", linked=linked) == nxtomo.DEFINITION


def read_nxtomo(entry: h5py.Group, bounds: Bounds, selection: Wanted) -> FileContents:
    """Read one NXtomo entry."""
    dataset = guard.numbers(entry, nxtomo.DATA, bounds)
    if dataset is None:
        raise UnreadableScan("dataset-missing", f"the NXtomo entry {guard.name_of(entry)} has no {nxtomo.DATA}")
    check_scan_dimensions(nxtomo.DATA, dataset.shape)
    keys, of_keys = _read_image_key(entry, len(dataset), bounds.whole)
    views = keys == nxtomo.PROJECTION
    angles = _angles_of_views(fields.read_angles(entry, nxtomo.ANGLES, bounds.whole, default_unit=None), views)
    pitch, row_pitch = (
        fields.read_pitch(entry, nxtomo.CELL_PITCH, bounds.whole),
        fields.read_pitch(entry, nxtomo.ROW_PITCH, bounds.whole),
    )
    modules, of_modules = read_modules(entry, dataset.shape[-1], pitch.mm, bounds)
    arc_radius_mm, of_arc = _arc_radius(entry, dataset.shape[-1] * (pitch.mm or np.inf), bounds)
    packed = fields.packing_remarks(dataset, guard.numbers(entry, nxtomo.ANGLES, bounds.whole))
    contents = FileContents(
        format="hdf5-nxtomo",
        projections=fields.chosen_views(dataset, np.flatnonzero(views)),
        flats=_fields(dataset, keys, nxtomo.FLAT, bounds),
        darks=_fields(dataset, keys, nxtomo.DARK, bounds),
        angles=angles,
        pitch=pitch,
        row_pitch=row_pitch,
        order=selection.order(dataset.ndim) or fields.stated_order(dataset),
        detector_modules=modules,
        detector_arc_radius_mm=arc_radius_mm,
        unused=guard.read_text(entry, f"{nxtomo.GIVEN}/{nxtomo.CONSTANTS}", linked=bounds.linked),
        remarks=(*of_keys, *packed, *pitch.remarks, *row_pitch.remarks, *of_modules, *of_arc),
    )
    return fields.with_fields_beside(contents, dataset, bounds.whole, selection)


def _angles_of_views(angles: FileAngles, views: NDArray[np.bool_]) -> FileAngles:
    """Select the views' angles among the angles of all images; a list for the views alone needs no selection."""
    if angles.deg is None or len(angles.deg) == np.count_nonzero(views):
        return angles
    if len(angles.deg) == len(views):
        return replace(angles, deg=angles.deg[views])
    numbers_of = {"angles": len(angles.deg), "images": len(views), "views": int(np.count_nonzero(views))}
    return FileAngles(unusable=ReadingMessage.ANGLES_OF_OTHER_NUMBER(path=nxtomo.ANGLES, **numbers_of))


def _read_image_key(entry: h5py.Group, images: int, bounds: Bounds) -> tuple[NDArray[np.int64], tuple[Reason, ...]]:
    """Read the key of each image, and remark what is left out."""
    control = guard.numbers(entry, nxtomo.IMAGE_KEY_CONTROL, bounds)
    dataset = guard.numbers(entry, nxtomo.IMAGE_KEY, bounds) or control
    if dataset is None:
        return np.zeros(images, dtype=np.int64), (ReadingMessage.NO_IMAGE_KEY(path=nxtomo.IMAGE_KEY),)
    if dataset.shape != (images,):
        raise UnreadableScan(
            "wrong-shape",
            f"{nxtomo.IMAGE_KEY} has the shape {dataset.shape} for {images} images; each image needs one key",
        )
    raw, alignment_key = guard.read_values(dataset, np.float64), nxtomo.IMAGE_KEY
    if control is not None and control.shape == raw.shape:
        aligning = guard.read_values(control, np.float64) == nxtomo.ALIGNMENT
        raw, alignment_key = (
            np.where(aligning, nxtomo.ALIGNMENT, raw),
            nxtomo.IMAGE_KEY_CONTROL if aligning.any() else nxtomo.IMAGE_KEY,
        )
    unknown = ~np.isin(raw, (nxtomo.PROJECTION, nxtomo.FLAT, nxtomo.DARK, nxtomo.INVALID, nxtomo.ALIGNMENT))
    if unknown.any():
        image = int(np.argmax(unknown))
        raise UnreadableScan(
            "wrong-type",
            f"{nxtomo.IMAGE_KEY} of image {image} is {raw[image]:g}; "
            "it must be 0 (projection), 1 (flat), 2 (dark) or 3 (invalid)",
        )
    invalid, alignment = (int(np.count_nonzero(raw == key)) for key in (nxtomo.INVALID, nxtomo.ALIGNMENT))
    of_alignment = ReadingMessage.ALIGNMENT_IMAGES(images=alignment, key=alignment_key.rpartition("/")[2])
    numbered = ((invalid, ReadingMessage.INVALID_IMAGES(images=invalid)), (alignment, of_alignment))
    return raw.astype(np.int64), tuple(remark for images, remark in numbered if images)


def _fields(dataset: h5py.Dataset, keys: NDArray[np.int64], key: int, bounds: Bounds) -> NDArray[np.float32] | None:
    images = np.flatnonzero(keys == key)
    # The library counts nothing for data in other files; these were checked as a whole.
    check_size(
        f"{nxtomo.DATA} of image_key {key}",
        (len(images), *dataset.shape[1:]),
        dataset.dtype.itemsize,
        stored_bytes=dataset.id.get_storage_size() or dataset.nbytes,
        max_bytes=bounds.piece,
    )
    return fields.scaling_of(dataset).apply(guard.read_images(dataset, images)) if len(images) else None


def _arc_radius(entry: h5py.Group, width_mm: float, bounds: Bounds) -> tuple[float | None, tuple[Reason, ...]]:
    """Read the radius of the arc, or the remark why it was ignored: the detector is at most half a circle."""
    dataset = guard.numbers(entry, nxtomo.ARC_RADIUS, bounds.whole)
    if dataset is None:
        return None, ()
    unit = guard.attribute_text(dataset, "units")
    radius_mm, why = length_of(guard.read_values(dataset, np.float64), unit and quoted(unit))
    if radius_mm is not None and not width_mm / math.pi < radius_mm <= LARGEST_MM:
        radius_mm, why = None, ReadingMessage.LENGTH_STATES_NOTHING(length_mm=f"{radius_mm:g}")
    return radius_mm, () if why is None else (ReadingMessage.LENGTH_IGNORED(why, path=nxtomo.ARC_RADIUS),)


def read_modules(
    entry: h5py.Group, cells: int, pitch_mm: float | None, bounds: Bounds
) -> tuple[tuple[DetectorModule, ...], tuple[Reason, ...]]:
    """Read the modules after the first, and the remark why they were ignored."""
    detector = guard.find(entry, nxtomo.DETECTOR, bounds.linked)
    if not isinstance(detector, h5py.Group):
        return (), ()
    # Of links elsewhere none is followed here: the detector's group may have any, to what is not read.
    hard = (guard.text_of(key) for key, kind in guard.members(detector) if kind == h5py.h5l.TYPE_HARD)
    nodes = (guard.find(detector, name, bounds.linked) for name in hard)
    modules = (
        node for node in nodes if isinstance(node, h5py.Group) and guard.attribute_text(node, "NX_class") == CLASS
    )
    groups = list(islice(modules, MOST_MODULES + 1))
    if not groups:
        return (), ()
    try:
        return modules_after_first([_placed(group, bounds) for group in groups], cells, pitch_mm), ()
    except ModulesUnusable as why:
        return (), (ReadingMessage.MODULES_IGNORED(path=nxtomo.DETECTOR, why=str(why)),)


def _placed(group: h5py.Group, bounds: Bounds) -> PlacedModule:
    # Of the cells of a module, of the axes of an image, the last one is along the line.
    first, cells = (float(_numbers_at(group, name, bounds)[1][-1]) for name in (ORIGIN, SIZE))
    if not (first.is_integer() and cells.is_integer() and first >= 0.0 and cells >= 1.0):
        raise ModulesUnusable(f"one begins at cell {first:g} and has {cells:g} cells")
    return PlacedModule(int(first), int(cells), *(_translation(group, name, bounds) for name in (OFFSET, STEP)))


def _numbers_at(group: h5py.Group, name: str, bounds: Bounds) -> tuple[h5py.Dataset, NDArray[np.float64]]:
    dataset = guard.numbers(group, name, bounds.whole)
    if dataset is None or not 1 <= dataset.size <= 3:
        raise ModulesUnusable(f"one has no {name} of one to three numbers")
    values = guard.read_values(dataset, np.float64).reshape(-1)
    if not np.isfinite(values).all():
        raise ModulesUnusable(f"the {name} of one is no finite number")
    return dataset, values


def _translation(group: h5py.Group, name: str, bounds: Bounds) -> Vector:
    """Read a length along its vector, mm."""
    dataset, values = _numbers_at(group, name, bounds)
    length_mm = to_mm(float(values[0]), guard.attribute_text(dataset, "units") or "")
    if length_mm is None:
        raise ModulesUnusable(f"the {name} of one is no length with a unit, along a vector")
    return translation(length_mm, guard.attribute(dataset, "vector"), name)
