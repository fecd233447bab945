"""HDF5 in the NXtomo layout: one stack of images (views, flat and dark fields), an image key and an angle for each."""

from dataclasses import dataclass

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.arrays import Bounds, LinkedFiles, check_scan_dimensions, check_size
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.hdf5.fields import read_angles, read_pitch
from sawmill_formats.input.hdf5.guard import Node, check_members, children, name_of, numbers, read_images, read_values
from sawmill_formats.input.hdf5.modules import read_modules
from sawmill_formats.input.hdf5.projections import chosen_views
from sawmill_formats.input.hdf5.texts import read_text
from sawmill_formats.nxtomo import (
    ANGLES,
    CELL_PITCH,
    DARK,
    DATA,
    DEFINITION,
    FLAT,
    IMAGE_KEY,
    INVALID,
    PROJECTION,
    ROW_PITCH,
)
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


def read_nxtomo(entry: h5py.Group, bounds: Bounds) -> FileContents:
    """Read one NXtomo entry.

    Raises
    ------
    UnreadableScan
        When a part is missing, or the parts do not agree.
    """
    dataset = numbers(entry, DATA, bounds)
    if dataset is None:
        raise UnreadableScan("dataset-missing", f"the NXtomo entry {name_of(entry)} has no {DATA}")
    check_scan_dimensions(DATA, dataset.shape)
    keys = _read_image_key(entry, len(dataset), bounds.whole)
    angles = read_angles(entry, ANGLES, bounds.whole, default_unit=None)
    if angles.deg is not None and len(angles.deg) != len(dataset):
        raise UnreadableScan(
            "angles-mismatch", f"{ANGLES} has {len(angles.deg)} angles for {len(dataset)} images; each image needs one"
        )
    detector_pitch_mm, remarks_x = read_pitch(entry, CELL_PITCH, bounds.whole)
    row_pitch_mm, remarks_y = read_pitch(entry, ROW_PITCH, bounds.whole)
    modules, of_modules = read_modules(entry, dataset.shape[-1], detector_pitch_mm, bounds)
    return FileContents(
        format="hdf5-nxtomo",
        projections=chosen_views(dataset, np.flatnonzero(keys.values == PROJECTION)),
        flats=_fields(dataset, keys.values, FLAT, bounds),
        darks=_fields(dataset, keys.values, DARK, bounds),
        angles_deg=None if angles.deg is None else angles.deg[keys.values == PROJECTION],
        angles_unit=angles.unit,
        angles_unusable=angles.unusable,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
        detector_modules=modules,
        remarks=(*keys.remarks, *remarks_x, *remarks_y, *of_modules),
    )


@dataclass(frozen=True)
class _ImageKeys:
    values: NDArray[np.int64]
    remarks: tuple[Reason, ...]


def _read_image_key(entry: h5py.Group, images: int, bounds: Bounds) -> _ImageKeys:
    dataset = numbers(entry, IMAGE_KEY, bounds)
    if dataset is None:
        return _ImageKeys(np.zeros(images, dtype=np.int64), (ReadingMessage.NO_IMAGE_KEY(path=IMAGE_KEY),))
    if dataset.shape != (images,):
        raise UnreadableScan(
            "wrong-shape", f"{IMAGE_KEY} has the shape {dataset.shape} for {images} images; each image needs one key"
        )
    raw = read_values(dataset, np.float64)
    unknown = ~np.isin(raw, (PROJECTION, FLAT, DARK, INVALID))
    if unknown.any():
        image = int(np.argmax(unknown))
        raise UnreadableScan(
            "wrong-type",
            f"{IMAGE_KEY} of image {image} is {raw[image]:g}; "
            "it must be 0 (projection), 1 (flat), 2 (dark) or 3 (invalid)",
        )
    invalid = int(np.count_nonzero(raw == INVALID))
    remarks = (ReadingMessage.INVALID_IMAGES(images=invalid),) if invalid else ()
    return _ImageKeys(raw.astype(np.int64), remarks)


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
    return read_images(dataset, images) if len(images) else None
