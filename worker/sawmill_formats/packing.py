"""Packing of whole chunks as the HDF5 library's filters would, in half their time and outside the library's lock.

The stream is plain deflate, so every reader unpacks it; only the search for repeats is left out, which finds nothing in
the noise of a reconstruction: runs and the frequencies of bytes are what there is to save.
"""

import struct
import zlib
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

# Words a block of the checksum, whose sums are computed from the blocks' sums.
WORDS_AT_ONCE = 4096


def pack(chunk: NDArray[Any]) -> bytes:
    """Pack a chunk of a dataset made with shuffle, gzip and fletcher32, as `write_direct_chunk` takes it."""
    values = np.ascontiguousarray(chunk)
    planes = np.ascontiguousarray(values.view(np.uint8).reshape(-1, values.itemsize).T)
    deflate = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
    packed = deflate.compress(planes.data) + deflate.flush()
    return packed + struct.pack("<I", fletcher32(packed))


def write_chunk(dataset: h5py.Dataset, index: int, packed: bytes) -> None:
    """Write a packed chunk at an index of the first axis, which spans the others."""
    dataset.id.write_direct_chunk((index, *(0 for _ in dataset.shape[1:])), packed)


def fletcher32(data: bytes) -> int:
    """Compute HDF5's checksum: two sums of big-endian 16-bit words modulo 65535, an odd byte padded with zero."""
    odd = len(data) % 2
    # Zeros in front add nothing to either sum, as the second sum counts places from the end.
    words = np.frombuffer(b"\0" * (-(len(data) + odd) % (2 * WORDS_AT_ONCE)) + data + b"\0" * odd, ">u2")
    if not words.any():
        return 0
    places = np.arange(WORDS_AT_ONCE, 0, -1.0)
    # Exact in double precision: both are less than 2^41.
    blocks = words.reshape(-1, WORDS_AT_ONCE).astype(np.float64) @ np.stack([np.ones_like(places), places], axis=1)
    sums, weighted = blocks.astype(np.uint64).T
    behind = np.arange(len(sums) - 1, -1, -1, dtype=np.uint64) * np.uint64(WORDS_AT_ONCE) % np.uint64(65535)
    # A sum that is a multiple of 65535 is written as 65535, not as 0: the library folds, it does not divide.
    first, second = ((int(total) - 1) % 65535 + 1 for total in (sums.sum(), weighted.sum() + sums @ behind))
    return second << 16 | first
