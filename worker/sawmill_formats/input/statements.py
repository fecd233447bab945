"""Values that a file states besides what a reader of scans uses: texts, numbers, names of files, attributes, tags."""

import re
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from sawmill_formats.detector_modules import OFFSET, ORIGIN, SIZE, STEP
from sawmill_formats.errors import quoted
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import PartKind, kind_of
from sawmill_formats.input.hdf5 import guard
from sawmill_formats.input.named_arrays import OTHER_NAMES, PROJECTION_NAMES
from sawmill_formats.input.recognising import FOLDER, HDF5, TIFF, recognise
from sawmill_formats.input.tiff.pages import opened_tiff

# Names that a reader uses, or that only say how values are stored.
USED = re.compile(
    "|".join((*PROJECTION_NAMES, *OTHER_NAMES, ORIGIN, SIZE, OFFSET, STEP))
    + "|image_key(_control)?|rotation_angle|[xy]_(pixel_size|binning)|(detector|row)_pitch_mm|theta|data_(white|dark)|"
    "arc_radius|definition|NX_class|default|units|axes|signal|long_name|vector|depends_on|transformation_type|interpretation|"
    "scale_factor|add_offset|MATLAB_class|initial_angle|angle_unit"
)
# Tags of TIFF that only say how pixels are stored: "TIFF Revision 6.0", section 8.
STORAGE_TAGS = {254, 256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 284, 317, 322, 323, 324, 325, 339}
MOST_SHOWN = 8


def statements(path: Path, bounds: Bounds) -> Iterator[tuple[str, str]]:
    """Yield places and texts of what a file or a folder states besides what a reader of scans uses.

    Links are not followed. `UnreadableScan`: the file is damaged, or of no known format.
    """
    found = recognise(path)
    yield "its name", quoted(str(path.absolute()))
    if found is HDF5:
        with open_hdf5(path) as file:
            yield from _of_hdf5(file["/"], "", set())
        return
    for each in [path] if found is TIFF else sorted(path.glob("*.tif*")) if found is FOLDER else []:
        with opened_tiff(each, each.name, each.stat().st_size) as tiff:
            tags = [tag for page in tiff.pages[:1] for tag in page.aspage().tags if tag.code not in STORAGE_TAGS]
            yield from ((f"{quoted(each.name)}: {tag.name}", _text(tag.value)) for tag in tags)
    for part in found.parts(path, bounds) if found is not TIFF else ():
        if part.kind is PartKind.FILE or not _is_used(part.name):
            yield part.name, f"{part.kind} {part.type or ''} {part.shape or ''}"


def _of_hdf5(node: h5py.Group | h5py.Dataset, name: str, seen: set[guard.Address]) -> Iterator[tuple[str, str]]:
    if guard.address_of(node) in seen:
        return
    seen.add(guard.address_of(node))
    guard.check_members(len(seen))
    yield from ((f"{name}@{quoted(key)}", _text(guard.attribute(node, key))) for key in node.attrs if not _is_used(key))
    if isinstance(node, h5py.Dataset):
        if not _is_used(name):
            few = 0 < (node.size or 0) <= MOST_SHOWN and not (node.is_virtual or node.external)
            yield name, _text(node[()]) if few else f"{node.dtype} {node.shape}"
        return
    for key, link in guard.members(node):
        place = f"{name}/{quoted(guard.text_of(key))}"
        if link != h5py.h5l.TYPE_HARD:
            yield place, quoted(str(node.id.links.get_val(key)))
        elif isinstance(child := node[key], h5py.Group | h5py.Dataset):
            yield from _of_hdf5(child, place, seen)


def _text(value: object) -> str:
    values = np.asarray(value).reshape(-1)[:MOST_SHOWN]
    return quoted(
        " ".join(each.decode("utf-8", "replace") if isinstance(each, bytes) else str(each) for each in values)
    )


def _is_used(name: str) -> bool:
    last = name.rpartition("/")[2]
    return USED.fullmatch(last) is not None or kind_of(last) is not None
