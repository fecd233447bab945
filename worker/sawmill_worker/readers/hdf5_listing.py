"""What is in an HDF5 file: groups, datasets and links, from their headers alone."""

from collections.abc import Iterator
from pathlib import Path

import h5py

from sawmill_worker.files.errors import quoted
from sawmill_worker.files.hdf5 import open_hdf5
from sawmill_worker.readers.arrays import Bounds
from sawmill_worker.readers.hdf5_guard import DEEPEST_GROUP, check_members, members, text_of
from sawmill_worker.readers.hdf5_storage import filter_names
from sawmill_worker.readers.hdf5_texts import attribute_text
from sawmill_worker.readers.parts import Part, PartKind

MOST_FILES_NAMED = 3


def hdf5_parts(path: Path, _: Bounds) -> Iterator[Part]:
    """Every group, dataset and link; an object that has two names is listed once, and links are not followed.

    Raises
    ------
    UnreadableScan
        `too-large` for more of them than are read.
    """
    with open_hdf5(path) as file:
        yield from _Listing().walk(file["/"], "/", 1)


class _Listing:
    """The names of the objects that were listed, by their addresses, and the number of all members."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}
        self._members = 0

    def walk(self, group: h5py.Group, prefix: str, depth: int) -> Iterator[Part]:
        self._members += len(group)
        check_members(self._members)
        for key, link in members(group):
            name = prefix + quoted(text_of(key))
            if link == h5py.h5l.TYPE_HARD:
                yield from self._object(group[key], name, depth)
            else:
                yield Part(name, PartKind.LINK, leads_to=_target(group, key, link))

    def _object(self, node: object, name: str, depth: int) -> Iterator[Part]:
        if not isinstance(node, h5py.Group | h5py.Dataset):
            yield Part(name, PartKind.GROUP, type="a named type")
            return
        address = h5py.h5o.get_info(node.id).addr
        if address in self._names:
            yield Part(name, PartKind.LINK, leads_to=self._names[address])
            return
        self._names[address] = name
        if isinstance(node, h5py.Dataset):
            yield _dataset(node, name)
            return
        yield Part(name, PartKind.GROUP, type=_quoted(attribute_text(node, "NX_class")))
        if depth < DEEPEST_GROUP:
            yield from self.walk(node, f"{name}/", depth + 1)


def _dataset(node: h5py.Dataset, name: str) -> Part:
    return Part(
        name,
        PartKind.DATASET,
        shape=node.shape,
        type=_type_of(node),
        unit=_quoted(attribute_text(node, "units")),
        stored_bytes=node.id.get_storage_size(),
        compression=", ".join(filter_names(node)) or None,
        leads_to=_sources(node),
    )


def _type_of(node: h5py.Dataset) -> str:
    if h5py.check_string_dtype(node.dtype) is not None:
        return "text"
    return quoted(node.dtype.name)


def _sources(node: h5py.Dataset) -> str | None:
    """The files in which the data of a dataset lie, where it is not this one."""
    if node.is_virtual:
        return _listed("virtual, of", [f"{each.file_name}:{each.dset_name}" for each in node.virtual_sources()])
    return _listed("stored in", [name for name, _, _ in node.external]) if node.external else None


def _listed(what: str, names: list[str]) -> str:
    different = list(dict.fromkeys(names))
    more = f" and {len(different) - MOST_FILES_NAMED} more" if len(different) > MOST_FILES_NAMED else ""
    return f"{what} {', '.join(quoted(name) for name in different[:MOST_FILES_NAMED])}{more}"


def _target(group: h5py.Group, key: bytes, link: int) -> str:
    if link == h5py.h5l.TYPE_SOFT:
        return quoted(text_of(group.id.links.get_val(key)))
    if link == h5py.h5l.TYPE_EXTERNAL:
        file, path = group.id.links.get_val(key)
        return f"file {quoted(text_of(file))}:{quoted(text_of(path))}"
    return "a link of an unknown kind"


def _quoted(text: str | None) -> str | None:
    return None if text is None else quoted(text)
