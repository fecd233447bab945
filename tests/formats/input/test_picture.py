"""Pictures of phantoms: grey values of any PNG, and of nothing else."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.picture import read_picture

GREY = np.random.default_rng(6).integers(0, 256, (9, 14), np.uint8)


def saved(path, picture: Image.Image, **options):
    picture.save(path / "picture.png", **options)
    return path / "picture.png"


def test_grey_is_read_as_it_is(tmp_path):
    read = read_picture(saved(tmp_path, Image.fromarray(GREY)))
    assert read.dtype == np.float32
    assert np.array_equal(read, GREY)


def test_transparency_is_ignored(tmp_path):
    alpha = np.random.default_rng(7).integers(0, 256, GREY.shape, np.uint8)
    rgba = np.stack([GREY, GREY, GREY, alpha], axis=-1)
    assert np.array_equal(read_picture(saved(tmp_path, Image.fromarray(rgba))), GREY)
    two = np.stack([GREY, alpha], axis=-1)
    assert np.array_equal(read_picture(saved(tmp_path, Image.fromarray(two, "LA"))), GREY)


def test_sixteen_bits_are_kept(tmp_path):
    deep = GREY.astype(np.uint16) * 251 + 3
    assert np.array_equal(read_picture(saved(tmp_path, Image.fromarray(deep))), deep)


def test_a_palette_is_looked_up(tmp_path):
    indices = (GREY % 3).astype(np.uint8)
    picture = Image.fromarray(indices, "P")
    picture.putpalette([0, 0, 0, 90, 90, 90, 255, 255, 255])
    read = read_picture(saved(tmp_path, picture, transparency=1))
    assert np.array_equal(read, np.array([0, 90, 255])[indices])


def test_black_and_white_is_read(tmp_path):
    read = read_picture(saved(tmp_path, Image.fromarray(GREY > 100)))
    assert np.array_equal(read > 0, GREY > 100)


def test_other_pictures_are_refused(tmp_path):
    Image.fromarray(GREY).save(tmp_path / "picture.png", format="JPEG")
    with pytest.raises(UnreadableScan, match="not a PNG file") as refusal:
        read_picture(tmp_path / "picture.png")
    assert refusal.value.code == "picture-not-png"


@pytest.mark.parametrize("keep", [8, 20, 40, -60])
def test_a_truncated_picture_is_refused(tmp_path, keep):
    path = saved(tmp_path, Image.fromarray(GREY))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UnreadableScan):
        read_picture(path)


@pytest.mark.parametrize("side", [8193, 20_000, 2**31 - 1])
def test_a_bomb_is_refused_unopened(tmp_path, side):
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0))
    bomb = b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    (tmp_path / "bomb.png").write_bytes(bomb)
    with pytest.raises(UnreadableScan):
        read_picture(tmp_path / "bomb.png")
