"""Chunks packed here are chunks of the HDF5 library: it unpacks them and checks their sums."""

import struct

import h5py
import numpy as np
import pytest

from sawmill_formats.nexus import PACKED
from sawmill_formats.output.volume_writer import fletcher32, pack, write_chunk


@pytest.fixture
def dataset(tmp_path):
    """A dataset (3, *shape) float32, one chunk to each index, and its file's path."""

    def new(shape):
        file = h5py.File(tmp_path / "packed.h5", "w")
        return file, file.create_dataset("data", (3, *shape), "f4", chunks=(1, *shape), **PACKED, fletcher32=True)

    return new


@pytest.mark.parametrize("shape", [(64, 48), (3, 5), (1, 1)])
@pytest.mark.parametrize("kind", ["noise", "zeros", "constant"])
def test_the_library_reads_what_was_packed(dataset, tmp_path, shape, kind):
    rng = np.random.default_rng(731)
    values = {"noise": rng.standard_normal((3, *shape)), "zeros": np.zeros((3, *shape)), "constant": 1e-3}[kind]
    values = np.broadcast_to(values, (3, *shape)).astype(np.float32)
    file, data = dataset(shape)
    for index, chunk in enumerate(values):
        write_chunk(data, index, pack(chunk))
    file.close()
    with h5py.File(tmp_path / "packed.h5") as again:
        np.testing.assert_array_equal(again["data"], values)


def test_the_checksum_is_the_library_s(dataset):
    file, data = dataset((40, 41))
    data[...] = np.random.default_rng(732).standard_normal((3, 40, 41))
    file.flush()
    for index in range(3):
        _, stored = data.id.read_direct_chunk((index, 0, 0))
        assert struct.pack("<I", fletcher32(stored[:-4])) == stored[-4:]
    file.close()


def test_a_sum_of_65535_stays_and_nothing_has_the_sum_0():
    assert fletcher32(b"\xff\xff") == 0xFFFFFFFF
    assert fletcher32(b"\0\0\0") == 0
    assert fletcher32(b"\x01") == 0x01000100


def test_a_damaged_chunk_is_reported(dataset, tmp_path):
    file, data = dataset((64, 48))
    write_chunk(data, 0, pack(np.random.default_rng(733).standard_normal((64, 48)).astype(data.dtype)))
    offset = data.id.get_chunk_info(0).byte_offset
    file.close()
    whole = bytearray((tmp_path / "packed.h5").read_bytes())
    whole[offset + 100] ^= 1
    (tmp_path / "packed.h5").write_bytes(whole)
    with h5py.File(tmp_path / "packed.h5") as again, pytest.raises(OSError, match=r"checksum|filter"):
        again["data"][0]
