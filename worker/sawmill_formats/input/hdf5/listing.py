"""Contents of an HDF5 file: groups, datasets and links, from their headers alone."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import h5py

from sawmill_formats.errors import quoted
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.input.arrays import Bounds, LinkedFiles
from sawmill_formats.input.contents import Part, PartKind
from sawmill_formats.input.hdf5 import guard
from sawmill_formats.input.hdf5.links import located
from sawmill_formats.input.hdf5.storage import filter_names

MOST_FILES_NAMED = 3


def hdf5_parts(path: Path, bounds: Bounds) -> Iterator[Part]:
    """Yield every group, dataset and link; an object that has two names is listed once.

    For a link into another file its existence is reported and, where links are followed, its target, without members.
    """
    with open_hdf5(path) as file:
        yield from _Listing(bounds.linked).walk(file["/"], "/", 1)


class _Listing:
    """The names of the objects that were listed, by their addresses, and the number of all members."""

    def __init__(self, linked: LinkedFiles | None) -> None:
        self._linked = linked
        self._names: dict[guard.Address, str] = {}
        self._members = 0

    def walk(self, group: h5py.Group, prefix: str, depth: int) -> Iterator[Part]:
        self._members += len(group)
        guard.check_members(self._members)
        for key, link in guard.members(group):
            name = prefix + quoted(guard.text_of(key))
            if link == h5py.h5l.TYPE_HARD:
                yield from self._object(group[key], name, depth)
            elif link == h5py.h5l.TYPE_EXTERNAL:
                yield self._external(group, key, name)
            else:
                soft = link == h5py.h5l.TYPE_SOFT
                target = quoted(guard.text_of(group.id.links.get_val(key))) if soft else "a link of an unknown kind"
                yield Part(name, PartKind.LINK, leads_to=target)

    def _external(self, group: h5py.Group, key: bytes, name: str) -> Part:
        file, path = map(guard.text_of, group.id.links.get_val(key))
        target = f"file {quoted(file)}:{quoted(path)}"
        if located(Path(group.file.filename), file) is None:
            return Part(name, PartKind.LINK, leads_to=f"{target} (not there)")
        node = None if self._linked is None else guard.find(group, guard.text_of(key), self._linked)
        if not isinstance(node, h5py.Dataset):
            return Part(name, PartKind.LINK, leads_to=target)
        return replace(_dataset(node, name), kind=PartKind.LINK, leads_to=target)

    def _object(self, node: object, name: str, depth: int) -> Iterator[Part]:
        if not isinstance(node, h5py.Group | h5py.Dataset):
            yield Part(name, PartKind.GROUP, type="a named type")
            return
        address = guard.address_of(node)
        if address in self._names:
            yield Part(name, PartKind.LINK, leads_to=self._names[address])
            return
        self._names[address] = name
        if isinstance(node, h5py.Dataset):
            yield _dataset(node, name)
            return
        yield Part(name, PartKind.GROUP, type=_quoted(guard.attribute_text(node, "NX_class")))
        if depth < guard.DEEPEST_GROUP:
            yield from self.walk(node, f"{name}/", depth + 1)


def _dataset(node: h5py.Dataset, name: str) -> Part:
    return Part(
        name,
        PartKind.DATASET,
        shape=node.shape,
        type=_type_of(node),
        unit=_quoted(guard.attribute_text(node, "units")),
        # The library counts nothing for a virtual dataset.
        stored_bytes=None if node.is_virtual else node.id.get_storage_size(),
        compression=", ".join(filter_names(node)) or None,
        leads_to=_sources(node),
    )


def _type_of(node: h5py.Dataset) -> str:
    try:
        return "text" if h5py.check_string_dtype(node.dtype) is not None else quoted(node.dtype.name)
    except TypeError:
        return "a type that NumPy does not have"


def _sources(node: h5py.Dataset) -> str | None:
    """Name the files in which the data of a dataset are, where these are other files."""
    if node.is_virtual:
        return _listed(node, "virtual, of", [each.file_name for each in node.virtual_sources()])
    return _listed(node, "stored in", [name for name, _, _ in node.external]) if node.external else None


def _listed(node: h5py.Dataset, what: str, names: list[str]) -> str:
    different = list(dict.fromkeys(names))
    own = Path(node.file.filename)
    missing = [name for name in different if name != "." and located(own, name) is None]
    more = f" and {len(different) - MOST_FILES_NAMED} more files" if len(different) > MOST_FILES_NAMED else ""
    lost = f" ({len(missing)} not there, first {quoted(missing[0])})" if missing else ""
    shown = ("this file" if name == "." else quoted(name) for name in different[:MOST_FILES_NAMED])
    return f"{what} {', '.join(shown)}{more}{lost}"


def _quoted(text: str | None) -> str | None:
    return None if text is None else quoted(text)
