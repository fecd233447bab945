"""The number of bytes that packed data unpack to, against what a decoder makes of them."""

import h5py
import numpy as np
import pytest
from tifffile import _imagecodecs

from sawmill_worker.readers.unpacking import LZF, PACKBITS


@pytest.mark.parametrize("levels", [1, 3, 255])
def test_lzf_as_hdf5_packs_it(tmp_path, levels):
    """From runs of one value to noise, where a chunk that cannot be packed is stored as it is."""
    values = np.random.default_rng(levels).integers(0, levels, 100_000).astype(np.uint8)
    with h5py.File(tmp_path / "a", "w") as file:
        data = file.create_dataset("a", data=values, chunks=values.shape, compression="lzf")
        skipped, packed = data.id.read_direct_chunk((0,))
    assert skipped or LZF.unpacked(packed, 10**9) == values.size


def test_packbits_of_any_bytes():
    rng = np.random.default_rng(4)
    for _ in range(50):
        packed = rng.bytes(200) + bytes(130)  # whatever comes last, its data follow
        end = len(_imagecodecs.packbits_decode(packed))
        assert abs(PACKBITS.unpacked(packed, 10**9) - end) <= 128


@pytest.mark.parametrize("packing", [LZF, PACKBITS])
def test_the_walk_ends_where_it_is_too_much(packing):
    packed = {"LZF": b"\0\0" + b"\xe0\xff\0" * 10_000, "PackBits": b"\x81\0" * 10_000}[packing.name]
    assert 1000 < packing.unpacked(packed, 1000) < 1300
    assert packing.unpacked(packed, 10**9) == {"LZF": 2_640_001, "PackBits": 1_280_000}[packing.name]
