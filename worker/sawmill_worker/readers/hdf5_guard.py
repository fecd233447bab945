"""HDF5 without its doors: nothing outside the file, nothing computed, nothing larger than what is stored.

Everything here is decided from the file's structure, before any data are read.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, TypeAlias

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_worker.files.errors import UnreadableScan, quoted
from sawmill_worker.readers.arrays import Bounds, check_number_type, check_packed, check_size

MOST_SOFT_LINKS = 16
MOST_CHILDREN = 10_000
DEEPEST_GROUP = 8

# Filters of the library itself and of h5py; any other would be looked for as a plug-in on this machine.
KNOWN_FILTERS = frozenset(
    {
        h5py.h5z.FILTER_DEFLATE,
        h5py.h5z.FILTER_SHUFFLE,
        h5py.h5z.FILTER_FLETCHER32,
        h5py.h5z.FILTER_SZIP,
        h5py.h5z.FILTER_LZF,
    }
)

Node: TypeAlias = h5py.Group | h5py.Dataset


def find(start: Node, path: str) -> Node | None:
    """Follow a path link by link; None where it leads to nothing.

    Raises
    ------
    UnreadableScan
        `external-storage` for a link into another file, `unsupported-storage` for links that run in a circle.
    """
    here, pending, soft_links = start, _parts(path), 0
    if path.startswith("/"):
        here = start.file["/"]
    while pending:
        name = pending.pop(0)
        key = name.encode("utf-8", "surrogateescape")
        if not isinstance(here, h5py.Group) or not here.id.links.exists(key):
            return None
        kind = here.id.links.get_info(key).type
        if kind == h5py.h5l.TYPE_SOFT:
            soft_links += 1
            if soft_links > MOST_SOFT_LINKS:
                raise UnreadableScan(
                    "unsupported-storage",
                    f"the links behind {quoted(path)!r} run in a circle; link straight to the data",
                )
            target = here.id.links.get_val(key).decode("utf-8", "surrogateescape")
            pending = _parts(target) + pending
            here = here.file["/"] if target.startswith("/") else here
        elif kind == h5py.h5l.TYPE_HARD:
            here = here[name]
        else:
            raise UnreadableScan(
                "external-storage",
                f"{quoted(path)!r} leads through an external link into another file; put all data into one file",
            )
    return here


def children(group: h5py.Group) -> Iterator[tuple[str, Node]]:
    """Every member that exists, by name."""
    if len(group) > MOST_CHILDREN:
        raise UnreadableScan(
            "too-large",
            f"the group {quoted(group.name)!r} has {len(group)} members; at most {MOST_CHILDREN} are allowed",
        )
    for name in group:
        node = find(group, name)
        if node is not None:
            yield name, node


def datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Every dataset of the file with its path, each object once."""
    seen: set[int] = set()

    def walk(group: h5py.Group, prefix: str, depth: int) -> Iterator[tuple[str, h5py.Dataset]]:
        for name, node in children(group):
            address = h5py.h5o.get_info(node.id).addr
            if address in seen:
                continue
            seen.add(address)
            if isinstance(node, h5py.Dataset):
                yield prefix + name, node
            elif isinstance(node, h5py.Group) and depth < DEEPEST_GROUP:
                yield from walk(node, f"{prefix}{name}/", depth + 1)

    yield from walk(file["/"], "", 1)


def numbers(start: Node, path: str, bounds: Bounds) -> h5py.Dataset | None:
    """The dataset of numbers at a path, checked and not yet read; None where there is nothing.

    Raises
    ------
    UnreadableScan
        `external-storage`, `unsupported-storage`, `wrong-type`, `wrong-shape`, `truncated-file` or `too-large`.
    """
    node = find(start, path)
    if node is None:
        return None
    where = repr(quoted(path))
    if not isinstance(node, h5py.Dataset):
        raise UnreadableScan("wrong-shape", f"{where} must be a dataset of numbers and is something else")
    check_dataset(where, node, bounds)
    return node


def check_dataset(where: str, dataset: h5py.Dataset, bounds: Bounds) -> None:
    """Refuse a dataset that is not plain numbers stored inside this file, in a size that can be read."""
    _check_storage(where, dataset)
    check_number_type(where, dataset.dtype)
    if dataset.shape is None:
        raise UnreadableScan("wrong-shape", f"{where} is empty; it must hold numbers")
    stored, itemsize = dataset.id.get_storage_size(), dataset.dtype.itemsize
    check_size(where, dataset.shape, itemsize, stored_bytes=stored, max_bytes=bounds.array)
    if dataset.chunks is not None and math.prod(dataset.chunks) * itemsize > bounds.piece:
        raise UnreadableScan("too-large", f"{where} has chunks of {dataset.chunks} values; store it in smaller chunks")
    if dataset.size and not stored:
        raise UnreadableScan("truncated-file", f"{where} was declared and never written; export the file again")
    if dataset.chunks is not None:
        _check_chunks(where, dataset)


def _check_chunks(where: str, dataset: h5py.Dataset) -> None:
    stored: list[int] = []
    dataset.id.chunk_iter(lambda chunk: stored.append(chunk.size))
    declared = math.prod(-(-length // of_chunk) for length, of_chunk in zip(dataset.shape, dataset.chunks, strict=True))
    if len(stored) < declared:
        raise UnreadableScan(
            "truncated-file",
            f"{where} was written in part: {len(stored)} of its {declared} chunks; export the file again",
        )
    check_packed(f"a chunk of {where}", max(stored, default=0), math.prod(dataset.chunks) * dataset.dtype.itemsize)


def _check_storage(where: str, dataset: h5py.Dataset) -> None:
    if dataset.is_virtual or dataset.external:
        raise UnreadableScan(
            "external-storage", f"{where} takes its data from other files or datasets; put the data themselves into it"
        )
    filters = dataset.id.get_create_plist()
    for index in range(filters.get_nfilters()):
        code, _, _, name = filters.get_filter(index)
        if code not in KNOWN_FILTERS:
            raise UnreadableScan(
                "unsupported-storage",
                f"{where} is stored with the filter {quoted(repr(name))} ({code}); repack it with gzip or without",
            )


def read_float32(dataset: h5py.Dataset, *parts: slice) -> NDArray[np.float32]:
    """Read a checked dataset as float32; where parts are named, those of its axes, from the first on."""
    result = np.empty(_shape_of(dataset, parts), dtype=np.float32)
    dataset.read_direct(result, parts or None)
    return result


def read_images(dataset: h5py.Dataset, images: NDArray[np.intp], *parts: slice) -> NDArray[np.float32]:
    """Images by their rising indices, run by run as float32, and of their axes the parts that are named."""
    result = np.empty((len(images), *_shape_of(dataset, (slice(0, 1), *parts))[1:]), dtype=np.float32)
    for start, stop in _runs(images):
        first = int(images[start])
        dataset.read_direct(result, (slice(first, first + stop - start), *parts), np.s_[start:stop])
    return result


def _shape_of(dataset: h5py.Dataset, parts: tuple[slice, ...]) -> tuple[int, ...]:
    return (*(part.stop - part.start for part in parts), *dataset.shape[len(parts) :])


def _runs(images: NDArray[np.intp]) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(images) != 1) + 1
    bounds = [0, *edges.tolist(), len(images)]
    return ((start, stop) for start, stop in pairwise(bounds) if stop > start)


def read_text(start: Node, path: str, *, most_bytes: int | None = None) -> str | None:
    """The one string at a path; None where there is none.

    Raises
    ------
    UnreadableScan
        `external-storage`, `unsupported-storage`; `too-large` where it has more than `most_bytes`.
    """
    node = find(start, path)
    if not isinstance(node, h5py.Dataset) or node.size != 1 or h5py.check_string_dtype(node.dtype) is None:
        return None
    where = repr(quoted(path))
    _check_storage(where, node)
    if most_bytes is not None:
        claimed = _claimed_bytes(where, node)
        if claimed > most_bytes:
            raise UnreadableScan("too-large", f"{where} claims to have {claimed} bytes; at most {most_bytes} are read")
    return _as_text(np.asarray(node[()]).item())


def _claimed_bytes(where: str, dataset: h5py.Dataset) -> int:
    """The bytes that the library would allocate to read the one string of a dataset."""
    if h5py.check_string_dtype(dataset.dtype).length is not None:
        return math.prod(dataset.chunks or (1,)) * int(dataset.dtype.itemsize)
    offset = dataset.id.get_offset()
    if offset is None:
        raise UnreadableScan("unsupported-storage", f"{where} is not stored in one piece; store it without chunks")
    # A string without a fixed length: its length and where it lies (HDF5 file format specification, section IV.B).
    with open(dataset.file.filename, "rb") as stream:  # noqa: PTH123 - as h5py names it
        stream.seek(offset)
        return int.from_bytes(stream.read(4), "little")


def attribute_text(node: Node, name: str) -> str | None:
    """An attribute that is one string; None where there is none."""
    if name not in node.attrs:
        return None
    value = np.asarray(node.attrs[name])
    return _as_text(value.item()) if value.size == 1 else None


def _as_text(value: Any) -> str | None:  # noqa: ANN401 - whatever the file holds
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip("\0 ")
    return value.strip("\0 ") if isinstance(value, str) else None


def _parts(path: str) -> list[str]:
    return [part for part in path.split("/") if part not in {"", "."}]
