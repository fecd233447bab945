"""HDF5 in the NXtomo layout: images with an image key and an angle for each, and a line detector's modules."""

from dataclasses import replace
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
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.arrays import Bounds, LinkedFiles, check_scan_dimensions, check_size
from sawmill_formats.input.contents import FileAngles, FileContents, Wanted, to_mm
from sawmill_formats.input.hdf5.fields import (
    chosen_views,
    packing_remarks,
    read_angles,
    read_pitch,
    scaling_of,
    stated_order,
    with_fields_beside,
)
from sawmill_formats.input.hdf5.guard import (
    Node,
    attribute,
    attribute_text,
    check_members,
    children,
    find,
    members,
    name_of,
    numbers,
    read_images,
    read_text,
    read_values,
    text_of,
)
from sawmill_formats.nxtomo import (
    ALIGNMENT,
    ANGLES,
    CELL_PITCH,
    DARK,
    DATA,
    DEFINITION,
    DETECTOR,
    FLAT,
    IMAGE_KEY,
    IMAGE_KEY_CONTROL,
    INVALID,
    PROJECTION,
    ROW_PITCH,
)
from sawmill_vocabulary import DetectorModule
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage


def find_entries(file: h5py.File, linked: LinkedFiles | None = None) -> list[h5py.Group]:
    """Find every group, at the top or one level below it, whose `definition` is NXtomo."""
    top = [node for _, node in children(file["/"], linked) if isinstance(node, h5py.Group)]
    check_members(sum(map(len, top)))
    below = [node for group in top if not _is_nxtomo(group, linked) for _, node in children(group, linked)]
    return [group for group in (*top, *below) if _is_nxtomo(group, linked)]


def _is_nxtomo(node: Node, linked: LinkedFiles | None) -> bool:
    return isinstance(node, h5py.Group) and read_text(node, "definition", linked=linked) == DEFINITION


def read_nxtomo(entry: h5py.Group, bounds: Bounds, selection: Wanted) -> FileContents:
    """Read one NXtomo entry."""
    dataset = numbers(entry, DATA, bounds)
    if dataset is None:
        raise UnreadableScan("dataset-missing", f"the NXtomo entry {name_of(entry)} has no {DATA}")
    check_scan_dimensions(DATA, dataset.shape)
    keys, of_keys = _read_image_key(entry, len(dataset), bounds.whole)
    views = keys == PROJECTION
    angles = _angles_of_views(read_angles(entry, ANGLES, bounds.whole, default_unit=None), views)
    pitch, row_pitch = read_pitch(entry, CELL_PITCH, bounds.whole), read_pitch(entry, ROW_PITCH, bounds.whole)
    modules, of_modules = read_modules(entry, dataset.shape[-1], pitch.mm, bounds)
    packed = packing_remarks(dataset, numbers(entry, ANGLES, bounds.whole))
    contents = FileContents(
        format="hdf5-nxtomo",
        projections=chosen_views(dataset, np.flatnonzero(views)),
        flats=_fields(dataset, keys, FLAT, bounds),
        darks=_fields(dataset, keys, DARK, bounds),
        angles=angles,
        pitch=pitch,
        row_pitch=row_pitch,
        order=selection.order(dataset.ndim) or stated_order(dataset),
        detector_modules=modules,
        remarks=(*of_keys, *packed, *pitch.remarks, *row_pitch.remarks, *of_modules),
    )
    return with_fields_beside(contents, dataset, bounds.whole, selection)


def _angles_of_views(angles: FileAngles, views: NDArray[np.bool_]) -> FileAngles:
    """Select the views' angles among the angles of all images; a list for the views alone needs no selection."""
    if angles.deg is None or len(angles.deg) == np.count_nonzero(views):
        return angles
    if len(angles.deg) == len(views):
        return replace(angles, deg=angles.deg[views])
    numbers_of = {"angles": len(angles.deg), "images": len(views), "views": int(np.count_nonzero(views))}
    return FileAngles(unusable=ReadingMessage.ANGLES_OF_OTHER_NUMBER(path=ANGLES, **numbers_of))


def _read_image_key(entry: h5py.Group, images: int, bounds: Bounds) -> tuple[NDArray[np.int64], tuple[Reason, ...]]:
    """Read the key of each image, and remark what is left out."""
    control = numbers(entry, IMAGE_KEY_CONTROL, bounds)
    dataset = numbers(entry, IMAGE_KEY, bounds) or control
    if dataset is None:
        return np.zeros(images, dtype=np.int64), (ReadingMessage.NO_IMAGE_KEY(path=IMAGE_KEY),)
    if dataset.shape != (images,):
        raise UnreadableScan(
            "wrong-shape", f"{IMAGE_KEY} has the shape {dataset.shape} for {images} images; each image needs one key"
        )
    raw, alignment_key = read_values(dataset, np.float64), IMAGE_KEY
    if control is not None and control.shape == raw.shape:
        aligning = read_values(control, np.float64) == ALIGNMENT
        raw, alignment_key = np.where(aligning, ALIGNMENT, raw), IMAGE_KEY_CONTROL if aligning.any() else IMAGE_KEY
    unknown = ~np.isin(raw, (PROJECTION, FLAT, DARK, INVALID, ALIGNMENT))
    if unknown.any():
        image = int(np.argmax(unknown))
        raise UnreadableScan(
            "wrong-type",
            f"{IMAGE_KEY} of image {image} is {raw[image]:g}; "
            "it must be 0 (projection), 1 (flat), 2 (dark) or 3 (invalid)",
        )
    invalid, alignment = (int(np.count_nonzero(raw == key)) for key in (INVALID, ALIGNMENT))
    remarks = (ReadingMessage.INVALID_IMAGES(images=invalid),) if invalid else ()
    if alignment:
        remarks = (*remarks, ReadingMessage.ALIGNMENT_IMAGES(images=alignment, key=alignment_key.rpartition("/")[2]))
    return raw.astype(np.int64), remarks


def _fields(dataset: h5py.Dataset, keys: NDArray[np.int64], key: int, bounds: Bounds) -> NDArray[np.float32] | None:
    images = np.flatnonzero(keys == key)
    # The library counts nothing for data in other files; these were checked as a whole.
    stored = dataset.id.get_storage_size() or dataset.nbytes
    check_size(
        f"{DATA} of image_key {key}",
        (len(images), *dataset.shape[1:]),
        dataset.dtype.itemsize,
        stored_bytes=stored,
        max_bytes=bounds.piece,
    )
    return scaling_of(dataset).apply(read_images(dataset, images)) if len(images) else None


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
