"""Checks of how a dataset is stored, before the library reads, allocates or unpacks anything."""

import math
import sys

import h5py

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input import arrays

# Filters of the library itself and of h5py, but szip, which only the library unpacks and scanners do not use; for any
# other the library would search for a plug-in on this machine.
PACKINGS = {h5py.h5z.FILTER_DEFLATE: "deflate", h5py.h5z.FILTER_LZF: "LZF"}
FILTERS = PACKINGS | {h5py.h5z.FILTER_SHUFFLE: "shuffle", h5py.h5z.FILTER_FLETCHER32: "checksum"}
# Shuffle, one packing, a checksum.
MOST_FILTERS = 3


def check_dataset(where: str, dataset: h5py.Dataset, bounds: arrays.Bounds) -> None:
    """Refuse a dataset that is not plain numbers in a size that can be read, stored in files that may be read."""
    check_storage(where, dataset, elsewhere=bounds.linked is not None)
    arrays.check_number_type(where, dataset.dtype)
    if dataset.shape is None:
        raise UnreadableScan("wrong-shape", f"{where} is empty; it must hold numbers")
    itemsize = dataset.dtype.itemsize
    stored = (
        bounds.linked.stored_bytes(where, dataset, bounds)
        if bounds.linked is not None and _is_elsewhere(dataset)
        else _bytes_in_file(dataset)
    )
    arrays.check_size(where, dataset.shape, itemsize, stored_bytes=stored, max_bytes=bounds.array)
    if dataset.chunks is not None and math.prod(dataset.chunks) * itemsize > bounds.piece:
        raise UnreadableScan("too-large", f"{where} has chunks of {dataset.chunks} values; store it in smaller chunks")
    if dataset.size and not stored:
        raise UnreadableScan("truncated-file", f"{where} was declared and never written; export the file again")
    if dataset.chunks is not None:
        check_chunks(where, dataset)
        return
    declared = dataset.size * dataset.id.get_type().get_size()
    if stored < declared and not _is_elsewhere(dataset):
        raise UnreadableScan(
            "truncated-file", f"{where} declares {declared} bytes of data and the file holds {stored}; export it again"
        )


def _bytes_in_file(dataset: h5py.Dataset) -> int:
    """Count the bytes stored of a dataset; chunks that share their place take no more than the file has."""
    return int(min(dataset.id.get_storage_size(), dataset.file.id.get_filesize()))


def _is_elsewhere(dataset: h5py.Dataset) -> bool:
    return dataset.is_virtual or bool(dataset.external)


def check_chunks(where: str, dataset: h5py.Dataset) -> None:
    """Refuse a dataset with chunks that are missing, stored in more bytes than declared, or far larger than it.

    The number of bytes that chunks unpack to is checked on reading (`sawmill_formats.hdf5_chunks`).
    """
    stored = _Chunks()
    dataset.id.chunk_iter(stored.add)
    declared = math.prod(-(-length // of_chunk) for length, of_chunk in zip(dataset.shape, dataset.chunks, strict=True))
    if stored.count < declared:
        raise UnreadableScan(
            "truncated-file",
            f"{where} was written in part: {stored.count} of its {declared} chunks; export the file again",
        )
    chunk_bytes = math.prod(dataset.chunks) * dataset.id.get_type().get_size()
    what = f"a chunk of {where}"
    if dataset.id.get_create_plist().get_nfilters():
        arrays.check_packed(what, stored.largest, chunk_bytes)
    elif {stored.least, stored.largest} != {chunk_bytes}:
        # Without filters the library assumes that a chunk is as long as it declares, and reads what is stored.
        code, stores = ("truncated-file", stored.least) if stored.least < chunk_bytes else ("too-large", stored.largest)
        raise UnreadableScan(
            code, f"{what} declares {chunk_bytes} bytes of data and the file stores {stores} for them; export it again"
        )
    if stored.count * chunk_bytes > max(arrays.HARMLESS_BYTES, arrays.LARGEST_RATIO * _bytes_in_file(dataset)):
        raise UnreadableScan(
            "too-large",
            f"the chunks of {where} unpack to {stored.count * chunk_bytes} bytes while the file stores only "
            f"{_bytes_in_file(dataset)} of them; above {arrays.HARMLESS_BYTES >> 20} MiB it may be at most "
            f"{arrays.LARGEST_RATIO} times as many: store it in smaller chunks",
        )


class _Chunks:
    """The number of stored chunks, and the least and the largest of their sizes in bytes."""

    def __init__(self) -> None:
        self.count = self.largest = 0
        self.least = sys.maxsize

    def add(self, chunk: h5py.h5d.StoreInfo) -> None:
        self.count += 1
        self.largest, self.least = max(self.largest, chunk.size), min(self.least, chunk.size)


def _filters(dataset: h5py.Dataset) -> list[tuple[int, str]]:
    layout = dataset.id.get_create_plist()
    filters = (layout.get_filter(index) for index in range(layout.get_nfilters()))
    return [(code, quoted(name.decode(errors="replace"))) for code, _, _, name in filters]


def filter_names(dataset: h5py.Dataset) -> list[str]:
    """Name the filters of a dataset in their order; a filter that is not read by its name and its number."""
    return [FILTERS.get(code) or f"{name} ({code})" for code, name in _filters(dataset)]


def check_storage(where: str, dataset: h5py.Dataset, *, elsewhere: bool = False) -> None:
    """Refuse data in other files or datasets unless allowed, and data behind unknown filters or packed twice."""
    if _is_elsewhere(dataset) and not elsewhere:
        raise UnreadableScan(
            "external-storage", f"{where} takes its data from other files or datasets; put the data themselves into it"
        )
    filters = _filters(dataset)
    for code, name in filters:
        if code not in FILTERS:
            raise UnreadableScan(
                "unsupported-storage",
                f"{where} is stored with the filter {name} ({code}); repack it with gzip or without",
            )
    packings = [PACKINGS[code] for code, _ in filters if code in PACKINGS]
    if len(packings) > 1:
        raise UnreadableScan("unsupported-storage", f"{where} is packed twice ({', '.join(packings)}); pack it once")
    if len(filters) > MOST_FILTERS:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where} is stored with {len(filters)} filters; use at most {MOST_FILTERS}: shuffle, gzip and a checksum",
        )
    if packings and any(code == h5py.h5z.FILTER_SHUFFLE for code, _ in filters[1:]):
        raise UnreadableScan("unsupported-storage", f"{where} is shuffled after it was packed; shuffle it before")
