"""The number of bytes that packed data unpack to, against what a decoder makes of them."""

import numpy as np
from tifffile import _imagecodecs

from sawmill_formats.input.unpacking import PACKBITS


def test_packbits_of_any_bytes():
    rng = np.random.default_rng(4)
    for _ in range(50):
        packed = rng.bytes(200) + bytes(130)  # whatever comes last, its data follow
        end = len(_imagecodecs.packbits_decode(packed))
        assert abs(PACKBITS.unpacked(packed, 10**9) - end) <= 128


def test_the_walk_ends_where_it_is_too_much():
    packed = b"\x81\0" * 10_000
    assert 1000 < PACKBITS.unpacked(packed, 1000) < 1300
    assert PACKBITS.unpacked(packed, 10**9) == 1_280_000
