"""Our own HDF5 files, read as untrusted files.

The process that writes a result may have been taken over by the upload that it read. So only what our writers write is
read: plain arrays and texts, found by hard links alone, stored in the file itself, in the recorded shapes.
"""

import math
import os
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import NotAsWritten, damage_reported, quoted
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.hdf5_chunks import CHECKSUM_BYTES
from sawmill_platform.files.verified_results import regular_status

PACKED = (h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32)
CHECKED = (h5py.h5z.FILTER_FLETCHER32,)
MOST_MEMBERS = 10_000
# Bytes of a file besides its values: axes, texts, groups, and the index of its chunks.
OTHER_BYTES = 64 * 2**20
LONGEST_UNIT = 32
_PIECE_BYTES = 2**18

Shape = tuple[int, ...]
Found = TypeVar("Found", h5py.Dataset, NDArray[Any])


@contextmanager
def reading_own(path: Path) -> Iterator[h5py.File]:
    """Open a result and read it in the block."""
    regular_status(path)
    with damage_reported(path.name), open_hdf5(path) as file:
        yield file


def group_at(file: h5py.File, path: str) -> h5py.Group | None:
    """Find a group by hard links; None where there is nothing of this name."""
    member = _found(file, path)
    if member is not None and not isinstance(member, h5py.Group):
        raise NotAsWritten(f"{path} is no group")
    return member


def dataset_at(
    file: h5py.File, path: str, shape: Shape | None = None, filters: tuple[int, ...] | None = None
) -> h5py.Dataset | None:
    """Find a dataset by hard links, and check how it is stored; None where there is nothing of this name."""
    member = _found(file, path)
    if member is None:
        return None
    if not isinstance(member, h5py.Dataset) or member.is_virtual:
        raise NotAsWritten(f"{path} is no dataset of its own")
    if _check_stored(member) != filters:
        raise NotAsWritten(f"{path} is not stored as results are")
    if shape is not None and (member.shape != shape or member.dtype.kind not in "iuf"):
        raise NotAsWritten(f"{path} is {member.dtype} of shape {member.shape} and not numbers of shape {shape}")
    return member


def needed(member: Found | None, path: str) -> Found:
    """Return the object, or refuse the file without it."""
    if member is None:
        raise NotAsWritten(f"it has no {path}")
    return member


def values_at(file: h5py.File, path: str, shape: Shape | None = None) -> NDArray[Any] | None:
    """Read all values of a dataset that is stored in one piece; None where there is nothing of this name."""
    dataset = dataset_at(file, path, shape)
    return None if dataset is None else np.asarray(dataset[()])


def values_of(file: h5py.File, path: str, shape: Shape | None = None) -> NDArray[Any]:
    """Read all values as `values_at` does, of a dataset that the file must have."""
    return needed(values_at(file, path, shape), path)


def unit_of(dataset: h5py.Dataset) -> str:
    """Read the unit of a dataset's values."""
    unit = dataset.attrs["units"]
    text = unit.decode() if isinstance(unit, bytes) else unit
    if not (isinstance(text, str) and len(text) <= LONGEST_UNIT and text.isascii() and text.isprintable()):
        raise NotAsWritten(f"{_name_of(dataset)} has no unit that can be read")
    return text


def read_packed(dataset: h5py.Dataset, first: int, last: int) -> NDArray[Any]:
    """Read values first..last of the first axis of `PACKED` chunks that span the other axes.

    Chunks are unpacked here, in pieces: the library would hold a chunk three times, unpack whatever it holds, and
    compare its size afterwards.
    """
    length, *across = dataset.chunks
    if across != list(dataset.shape[1:]):
        raise NotAsWritten(f"{_name_of(dataset)} has chunks of {dataset.chunks}")
    values = np.empty((last - first, *across), dataset.dtype)
    for start in range(first - first % length, last, length):
        begin, end = max(start, first), min(start + length, last)
        target = values[begin - first : end - first]
        chunk = target if len(target) == length else np.empty((length, *across), dataset.dtype)
        _unpack(dataset, check_chunk(dataset, (start, *(0 for _ in across))), chunk)
        if chunk is not target:
            target[:] = chunk[begin - start : end - start]
    return values


def _unpack(dataset: h5py.Dataset, stored: h5py.h5d.StoreInfo, chunk: NDArray[Any]) -> None:
    """Unpack a chunk into an array; the chunk has the first bytes of all values, then the second ones, and so on."""
    descriptor, place = dataset.file.id.get_vfd_handle(), stored.byte_offset
    end, inflater, packed = place + stored.size - CHECKSUM_BYTES, zlib.decompressobj(), b""

    def read(most: int) -> bytes:
        """Unpack at most `most` bytes; none at the end of the chunk, or of the stream, which has a checksum."""
        nonlocal place, packed
        part, has_more = b"", True
        while has_more and not (part or inflater.eof):
            if not packed:
                packed = os.pread(descriptor, min(_PIECE_BYTES, end - place), place)
                place += len(packed)
            has_more = bool(packed)
            part, packed = inflater.decompress(packed, most), inflater.unconsumed_tail
        return part

    for values in chunk.reshape(-1).view(np.uint8).reshape(chunk.size, -1).T:
        filled = 0
        while filled < chunk.size and (part := read(min(_PIECE_BYTES, chunk.size - filled))):
            values[filled : filled + len(part)] = np.frombuffer(part, np.uint8)
            filled += len(part)
    if filled < chunk.size or read(1) or not inflater.eof:
        raise NotAsWritten(f"a chunk of {_name_of(dataset)} does not hold the {chunk.nbytes} bytes of its values")


def check_chunk(dataset: h5py.Dataset, offset: Shape) -> h5py.h5d.StoreInfo:
    """Return where a chunk is stored; refuse one that is not stored, or in another number of bytes than its values."""
    stored = dataset.id.get_chunk_info_by_coord(offset)
    _check_bytes(dataset, [stored])
    return stored


def check_chunks(dataset: h5py.Dataset) -> None:
    """Refuse a dataset with a chunk that `check_chunk` refuses."""
    stored: list[h5py.h5d.StoreInfo] = []
    dataset.id.chunk_iter(stored.append)
    declared = math.prod(-(-length // of_chunk) for length, of_chunk in zip(dataset.shape, dataset.chunks, strict=True))
    if len(stored) != declared:
        raise NotAsWritten(f"{_name_of(dataset)} has {len(stored)} of its {declared} chunks")
    _check_bytes(dataset, stored)


def _check_bytes(dataset: h5py.Dataset, chunks: Iterable[h5py.h5d.StoreInfo]) -> None:
    least = most = math.prod(dataset.chunks) * dataset.dtype.itemsize + CHECKSUM_BYTES
    if dataset.compression is not None:
        # Values that cannot be packed grow by a thousandth.
        least, most = CHECKSUM_BYTES + 1, most + most // 1000 + 64
    for chunk in chunks:
        if chunk.filter_mask or not least <= chunk.size <= most:
            raise NotAsWritten(f"a chunk of {_name_of(dataset)} takes {chunk.size} bytes and not {least} to {most}")


def check_members(file: h5py.File, path: Path, values_bytes: int) -> None:
    """Refuse a file with data elsewhere, or not stored as our writers store it, whichever program reads it."""
    size_bytes, most_bytes = path.stat().st_size, int(1.05 * values_bytes) + OTHER_BYTES
    if size_bytes > most_bytes:
        raise NotAsWritten(f"it has {size_bytes} bytes, and at most {most_bytes} are due")
    groups, seen, members = [file["/"]], {h5py.h5g.get_objinfo(file.id).objno}, 0
    while groups:
        group = groups.pop()
        members += len(group)
        if members > MOST_MEMBERS:
            raise NotAsWritten(f"it has more than {MOST_MEMBERS} groups and datasets")
        for name in group:
            member = _member(group, name)
            address = h5py.h5g.get_objinfo(member.id).objno
            if address in seen:
                continue
            seen.add(address)
            if isinstance(member, h5py.Group):
                groups.append(member)
            elif not isinstance(member, h5py.Dataset):
                raise NotAsWritten(f"{_name_of(member)} is neither a group nor a dataset")
            elif member.is_virtual:
                layout = member.id.get_create_plist()
                for place in range(layout.get_virtual_count()):
                    if layout.get_virtual_filename(place) != ".":
                        raise NotAsWritten(f"{_name_of(member)} takes its values from other files")
            else:
                _check_stored(member)
                if member.chunks is not None:
                    check_chunks(member)


def _found(file: h5py.File, path: str) -> h5py.Group | h5py.Dataset | h5py.Datatype | None:
    here = file["/"]
    for name in path.split("/"):
        if not isinstance(here, h5py.Group) or not here.id.links.exists(name.encode()):
            return None
        here = _member(here, name)
    return here


def _member(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset | h5py.Datatype:
    if group.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
        raise NotAsWritten(f"{quoted(name)} in {_name_of(group)} is a link to another place")
    return group[name]


def _check_stored(dataset: h5py.Dataset) -> tuple[int, ...] | None:
    """Refuse values in another file, and more values than are stored."""
    layout = dataset.id.get_create_plist()
    if layout.get_external_count():
        raise NotAsWritten(f"{_name_of(dataset)} takes its values from other files")
    shape, chunks = dataset.shape, dataset.chunks
    if chunks is None:
        declared = 0 if shape is None else math.prod(shape) * dataset.id.get_type().get_size()
        stored = dataset.id.get_storage_size()
        if stored < declared:
            raise NotAsWritten(f"{_name_of(dataset)} declares {declared} bytes and stores {stored}")
        return None
    filters = tuple(layout.get_filter(place)[0] for place in range(layout.get_nfilters()))
    if filters not in {PACKED, CHECKED} or any(most > length for length, most in zip(shape, chunks, strict=True)):
        raise NotAsWritten(f"{_name_of(dataset)} is not stored as results are")
    return filters


def _name_of(member: h5py.Group | h5py.Dataset | h5py.Datatype) -> str:
    return quoted(str(member.name).lstrip("/")) or "the file"
