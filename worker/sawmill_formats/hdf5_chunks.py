"""Values of HDF5 datasets that are stored in chunks, unpacked here and not by the library.

The library leaves the part of the buffer that a chunk does not fill as it was, so it reads a chunk that is stored
shorter than it declares as memory of this process. Here a chunk has exactly the bytes that it declares, or is refused.
"""

import zlib
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from math import prod
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.output.volume_writer import fletcher32

CHECKSUM_BYTES = 4

# Takes stored bytes, and a limit; returns the unpacked bytes, cut off somewhere beyond the limit.
Unpack = Callable[[NDArray[np.uint8], int], NDArray[np.uint8]]


class Chunks:
    """The chunks, each of `shape`, of a dataset whose filters and stored sizes were checked."""

    def __init__(self, dataset: h5py.Dataset) -> None:
        self.shape: tuple[int, ...] = dataset.chunks
        self._dataset, self._dtype = dataset, dataset.dtype
        self._type, self._of_numpy = dataset.id.get_type(), h5py.h5t.py_create(self._dtype)
        self._bytes = prod(self.shape) * self._type.get_size()
        self._converted = self._dtype.kind != "S" and not self._type.equal(self._of_numpy)
        layout = dataset.id.get_create_plist()
        self._unpack = [_unpack(dataset, layout.get_filter(place)[0]) for place in range(layout.get_nfilters())]

    def read(self, offset: tuple[int, ...]) -> NDArray[Any]:
        """Read the chunk that begins at `offset`, in its own shape and type."""
        try:
            # H5Dget_chunk_info_by_coord would go through all earlier chunks to find this one's place.
            skipped, stored = self._dataset.id.read_direct_chunk(offset)
        except RuntimeError as error:  # raised where the file gives no place for the chunk
            raise UnreadableScan(
                "truncated-file", f"{self._where(offset)} was never written; export the file again"
            ) from error
        data = np.frombuffer(stored, np.uint8)
        for place, unpack in reversed(list(enumerate(self._unpack))):
            if not skipped >> place & 1:
                if skipped and unpack is _without_checksum:
                    unpack = _checked  # noqa: PLW2901 - the deflate stream that has one of its own is what was skipped
                data = unpack(data, self._bytes + CHECKSUM_BYTES)
        if data.size != self._bytes:
            code, than = ("truncated-file", "less") if data.size < self._bytes else ("too-large", "more")
            raise UnreadableScan(
                code,
                f"{self._where(offset)} declares {self._bytes} bytes of data and holds {than}; export the file again",
            )
        if self._converted:
            count = prod(self.shape)
            room = np.zeros(count * max(self._type.get_size(), self._dtype.itemsize), np.uint8)
            room[: data.size] = data
            h5py.h5t.convert(self._type, self._of_numpy, count, room)
            data = room[: count * self._dtype.itemsize]
        return np.asarray(data.view(self._dtype).reshape(self.shape))

    def offsets(self) -> Iterator[tuple[int, ...]]:
        """List where every chunk of the dataset begins."""
        axes = zip(self._dataset.shape, self.shape, strict=True)
        return product(*(range(0, length, of_chunk) for length, of_chunk in axes))

    def _where(self, offset: tuple[int, ...]) -> str:
        return f"the chunk {offset} of {quoted(str(self._dataset.name))!r}"


def check_unpacked(dataset: h5py.Dataset) -> None:
    """Unpack every chunk of a checked dataset once, before the library does, as for a source of a virtual dataset."""
    chunks = Chunks(dataset)
    for offset in chunks.offsets():
        chunks.read(offset)


def load_kernels() -> None:
    """Load or compile the LZF kernel, so that no reading waits for it."""
    _of_lzf(np.frombuffer(b"\0\0", np.uint8), 1)


def read_chunked(
    dataset: h5py.Dataset, into: NDArray[Any], images: NDArray[np.intp], parts: tuple[slice, ...] = ()
) -> None:
    """Read images, rising indices, of a checked dataset in chunks, each once; values too large for `into` are infinite.

    `parts` are slices of the second and later axes, with start and stop inside the shape; omitted axes are read whole.
    """
    chunks = Chunks(dataset)
    length, *across = chunks.shape
    whole = (*parts, *(slice(0, n) for n in dataset.shape[1 + len(parts) :]))
    grid = [range(part.start // n * n, part.stop, n) for part, n in zip(whole, across, strict=True)]
    with np.errstate(over="ignore"):
        for first, start in product(np.unique(images // length) * length, product(*grid)):
            low, high = np.searchsorted(images, [first, first + length])
            chunk = chunks.read((int(first), *start))
            inside, target = [], []
            for part, at, n in zip(whole, start, across, strict=True):
                begin, end = max(part.start, at), min(part.stop, at + n)
                inside.append(slice(begin - at, end - at))
                target.append(slice(begin - part.start, end - part.start))
            into[slice(low, high), *target] = chunk[_as_slice(images[low:high] - first), *inside]


def _as_slice(rising: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Turn indices without gaps into a slice, which copies nothing."""
    first, last = int(rising[0]), int(rising[-1])
    return slice(first, last + 1) if last - first + 1 == len(rising) else rising


def _unpack(dataset: h5py.Dataset, code: int) -> Unpack:
    if code == h5py.h5z.FILTER_SHUFFLE:
        return partial(_unshuffled, dataset.id.get_type().get_size())
    if code == h5py.h5z.FILTER_FLETCHER32 and dataset.compression == "gzip":
        return _without_checksum
    return {
        h5py.h5z.FILTER_DEFLATE: _inflated,
        h5py.h5z.FILTER_LZF: _of_lzf,
        h5py.h5z.FILTER_FLETCHER32: _checked,
    }[code]


def _unshuffled(itemsize: int, data: NDArray[np.uint8], _: int) -> NDArray[np.uint8]:
    """Undo the shuffle: first bytes of all values come first, then the second ones; surplus bytes at the end stay."""
    count = data.size // itemsize * itemsize
    together = np.stack(list(data[:count].reshape(itemsize, -1)), axis=1).reshape(-1)
    return together if count == data.size else np.concatenate([together, data[count:]])


def _inflated(data: NDArray[np.uint8], most: int) -> NDArray[np.uint8]:
    inflater = zlib.decompressobj()
    inflated = inflater.decompress(data.data, most + 1)
    # A stream without its end has no checksum, so all of it is discarded.
    return np.frombuffer(inflated if (inflater.eof or len(inflated) > most) else b"", np.uint8)


def _of_lzf(data: NDArray[np.uint8], most: int) -> NDArray[np.uint8]:
    from sawmill_formats._chunks_numba import unpack_lzf  # noqa: PLC0415 - Numba, for such data only

    unpacked = np.empty(most + 1, np.uint8)
    count = unpack_lzf(data, unpacked)
    if count < 0:
        raise ValueError("LZF data that are cut off or refer to what is not there")
    return unpacked[:count]


def _without_checksum(data: NDArray[np.uint8], _: int) -> NDArray[np.uint8]:
    """Leave out the checksum of a deflate stream, which has its own at the end."""
    return data[:-CHECKSUM_BYTES]


def _checked(data: NDArray[np.uint8], _: int) -> NDArray[np.uint8]:
    values, stored = data[:-CHECKSUM_BYTES], data[-CHECKSUM_BYTES:]
    if fletcher32(values.tobytes()) != int.from_bytes(stored, "little"):
        raise ValueError("a chunk does not have the checksum that is stored with it")
    return values
