"""Safe access to HDF5: nothing outside the file, nothing computed, nothing larger than what is stored.

Everything here is decided from the file's structure, before any data are read. Texts and attributes have a length that
is checked before they are read.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, TypeAlias

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.hdf5_chunks import read_chunked
from sawmill_formats.input.arrays import Bounds, LinkedFiles
from sawmill_formats.input.hdf5.storage import check_chunks, check_dataset, check_storage

MOST_LINKS = 16
MOST_MEMBERS = 10_000
LONGEST_NAME_BYTES = 1024
DEEPEST_GROUP = 8

Node: TypeAlias = h5py.Group | h5py.Dataset
Address: TypeAlias = tuple[tuple[int, ...], tuple[int, ...]]


def address_of(node: Node) -> Address:
    """Return the file and the address of an object; `h5py.h5o.get_info` measures a chunk index too, and may crash."""
    about = h5py.h5g.get_objinfo(node.id)
    return tuple(about.fileno), tuple(about.objno)


def find(start: Node, path: str, linked: LinkedFiles | None = None) -> Node | None:
    """Follow a path link by link; None where it leads to nothing."""
    here, pending, links = start, _parts(path), 0
    if path.startswith("/"):
        here = start.file["/"]
    while pending:
        key = _key(pending.pop(0))
        if not isinstance(here, h5py.Group) or not here.id.links.exists(key):
            return None
        kind = here.id.links.get_info(key).type
        if kind == h5py.h5l.TYPE_HARD:
            here = here[key] if linked is None else _beside(here, key)
            continue
        links += 1
        if links > MOST_LINKS:
            raise UnreadableScan(
                "unsupported-storage", f"the links behind {quoted(path)!r} run in a circle; link straight to the data"
            )
        if kind == h5py.h5l.TYPE_SOFT:
            target = text_of(here.id.links.get_val(key))
            here = here.file["/"] if target.startswith("/") else here
        elif kind == h5py.h5l.TYPE_EXTERNAL and linked is not None:
            file, target = map(text_of, here.id.links.get_val(key))
            here = linked.root(here, file, path)
        else:
            raise UnreadableScan(
                "external-storage",
                f"{quoted(path)!r} leads through an external link into another file; put all data into one file",
            )
        pending = _parts(target) + pending
    return here


def _beside(group: h5py.Group, key: bytes) -> Node:
    """Open a group's member; files that it names are searched for next to its own, not where this process runs."""
    if h5py.h5g.get_objinfo(group.id, key).type != h5py.h5g.DATASET:
        return group[key]
    access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
    access.set_efile_prefix(b"${ORIGIN}")
    return h5py.Dataset(h5py.h5d.open(group.id, key, access))


def children(group: h5py.Group, linked: LinkedFiles | None = None) -> Iterator[tuple[str, Node]]:
    """Yield every member that exists, by name; in a name that is not UTF-8 the other bytes are surrogates.

    Where links are followed, those that lead to no file are noted and skipped: the request does not name them.
    """
    for key, _ in members(group):
        try:
            node = find(group, text_of(key), linked)
        except UnreadableScan as error:
            if linked is None or error.code != "linked-file-missing":
                raise
            linked.missing.append(error)
            continue
        if node is not None:
            yield text_of(key), node


def members(group: h5py.Group) -> Iterator[tuple[bytes, int]]:
    """Yield the stored name and the kind of link (`h5py.h5l`) of every member, unopened: `too-large`."""
    check_members(len(group))
    for stored in group:
        key = stored if isinstance(stored, bytes) else _key(stored)
        if len(key) > LONGEST_NAME_BYTES:
            raise UnreadableScan(
                "too-large",
                f"a name in the group {name_of(group)} has {len(key)} bytes; at most {LONGEST_NAME_BYTES} are read",
            )
        yield key, group.id.links.get_info(key).type


def text_of(key: bytes) -> str:
    """Decode a stored name; bytes that are not UTF-8 become surrogates."""
    return key.decode("utf-8", "surrogateescape")


def check_members(count: int) -> None:
    """Refuse a file with this number of members, before they are opened: `too-large`."""
    if count > MOST_MEMBERS:
        raise UnreadableScan(
            "too-large",
            f"the file has more than {MOST_MEMBERS} groups and datasets; leave out what is no part of the scan",
        )


def name_of(node: Node) -> str:
    """Return an object's path in its file, quoted."""
    name = node.name
    return repr(quoted(name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)))


def datasets(file: h5py.File, linked: LinkedFiles | None = None) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield every dataset of the file, and of files that it leads to, with its path, each object once."""
    seen: set[Address] = set()
    members = 0

    def walk(group: h5py.Group, prefix: str, depth: int) -> Iterator[tuple[str, h5py.Dataset]]:
        nonlocal members
        members += len(group)
        check_members(members)
        for name, node in children(group, linked):
            address = address_of(node)
            if address in seen:
                continue
            seen.add(address)
            if isinstance(node, h5py.Dataset):
                yield prefix + name, node
            elif isinstance(node, h5py.Group) and depth < DEEPEST_GROUP:
                yield from walk(node, f"{prefix}{name}/", depth + 1)

    yield from walk(file["/"], "", 1)


def numbers(start: Node, path: str, bounds: Bounds) -> h5py.Dataset | None:
    """Return the dataset of numbers at a path, checked and not yet read; None where there is nothing."""
    node = find(start, path, bounds.linked)
    if node is None:
        return None
    where = repr(quoted(path))
    if not isinstance(node, h5py.Dataset):
        raise UnreadableScan("wrong-shape", f"{where} is a group; it must be a dataset of numbers")
    check_dataset(where, node, bounds)
    return node


def read_values(dataset: h5py.Dataset, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """Read a checked dataset as a whole, in its own type or another one."""
    # Zeros, here and below, so that parts that the library does not fill show no memory of this process.
    result = np.zeros(dataset.shape, dataset.dtype if dtype is None else dtype)
    if dataset.chunks is None:
        dataset.read_direct(result)
    else:
        read_chunked(dataset, result, np.arange(len(dataset)))
    return result


def read_images(dataset: h5py.Dataset, images: NDArray[np.intp], *parts: slice) -> NDArray[np.float32]:
    """Read images by their rising indices, run by run as float32; `parts` select from the images' axes."""
    lengths = (*(part.stop - part.start for part in parts), *dataset.shape[len(parts) + 1 :])
    result = np.zeros((len(images), *lengths), dtype=np.float32)
    if dataset.chunks is not None:
        read_chunked(dataset, result, images, parts)
        return result
    for start, stop in _runs(images):
        first = int(images[start])
        dataset.read_direct(result, (slice(first, first + stop - start), *parts), np.s_[start:stop])
    return result


def _runs(images: NDArray[np.intp]) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(images) != 1) + 1
    return ((start, stop) for start, stop in pairwise([0, *edges.tolist(), len(images)]) if stop > start)


def _key(name: str) -> bytes:
    return name.encode("utf-8", "surrogateescape")


def _parts(path: str) -> list[str]:
    return [part for part in path.split("/") if part not in {"", "."}]


# Most bytes of a name, a unit or a similar text.
LONGEST_TEXT_BYTES = 4096


def read_text(
    start: Node, path: str, *, most_bytes: int = LONGEST_TEXT_BYTES, linked: LinkedFiles | None = None
) -> str | None:
    """Read the one string at a path, or None where there is none: `too-large` above `most_bytes`."""
    node = find(start, path, linked)
    if not isinstance(node, h5py.Dataset) or node.size != 1 or h5py.check_string_dtype(node.dtype) is None:
        return None
    where = repr(quoted(path))
    check_storage(where, node)
    claimed = _claimed_bytes(where, node)
    if claimed > most_bytes:
        raise UnreadableScan("too-large", f"{where} claims to have {claimed} bytes; at most {most_bytes} are read")
    if node.chunks is None:
        return _as_text(np.asarray(node[()]).item())
    check_chunks(where, node)
    return _as_text(read_values(node).item())


def _claimed_bytes(where: str, dataset: h5py.Dataset) -> int:
    """Return the bytes that the library would allocate to read the one string of a dataset."""
    if h5py.check_string_dtype(dataset.dtype).length is not None:
        return math.prod(dataset.chunks or (1,)) * int(dataset.dtype.itemsize)
    offset = dataset.id.get_offset()
    if offset is None:
        raise UnreadableScan("unsupported-storage", f"{where} is not stored in one piece; store it without chunks")
    # A string of variable length: its length and its place (HDF5 file format specification, section IV.B).
    with open(dataset.file.filename, "rb") as stream:  # noqa: PTH123 - as h5py names it
        stream.seek(offset)
        return int.from_bytes(stream.read(4), "little")


def attribute(node: Node, name: str) -> Any:  # noqa: ANN401 - whatever the file holds
    """Read the value of a short attribute, or None where there is none: `too-large`."""
    if name not in node.attrs:
        return None
    _check_attribute(node, name, h5py.h5a.open(node.id, name.encode()).get_storage_size())
    value = node.attrs[name]
    if isinstance(value, str | bytes):  # a text of variable length is stored elsewhere
        _check_attribute(node, name, len(value))
    return value


def _check_attribute(node: Node, name: str, claimed: int) -> None:
    if claimed > LONGEST_TEXT_BYTES:
        raise UnreadableScan(
            "too-large",
            f"the attribute {name} of {name_of(node)} claims to have {claimed} bytes; at most {LONGEST_TEXT_BYTES} "
            "are read",
        )


def attribute_text(node: Node, name: str) -> str | None:
    """Read an attribute that is one string; None where there is none."""
    value = np.asarray(attribute(node, name))
    return _as_text(value.item()) if value.size == 1 else None


def _as_text(value: Any) -> str | None:  # noqa: ANN401 - whatever the file holds
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip("\0 ")
    return value.strip("\0 ") if isinstance(value, str) else None
