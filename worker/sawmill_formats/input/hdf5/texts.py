"""Texts of HDF5 files and attributes of datasets, whose lengths are checked before they are read."""

import math
from typing import Any

import h5py
import numpy as np

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import LinkedFiles
from sawmill_formats.input.hdf5.guard import Node, find, name_of, read_values
from sawmill_formats.input.hdf5.storage import check_chunks, check_storage

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
