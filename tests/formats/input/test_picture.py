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


def palette(indices):
    picture = Image.fromarray(indices, "P")
    picture.putpalette([0, 0, 0, 90, 90, 90, 255, 255, 255])
    return picture


ALPHA = np.random.default_rng(7).integers(0, 256, GREY.shape, np.uint8)
DEEP, INDICES = GREY.astype(np.uint16) * 251 + 3, GREY % 3
READ = {
    "grey": (Image.fromarray(GREY), {}, GREY),
    "transparency is ignored": (Image.fromarray(np.stack([GREY, GREY, GREY, ALPHA], axis=-1)), {}, GREY),
    "transparent grey": (Image.fromarray(np.stack([GREY, ALPHA], axis=-1), "LA"), {}, GREY),
    "16 bits are kept": (Image.fromarray(DEEP), {}, DEEP),
    "a palette is looked up": (palette(INDICES), {"transparency": 1}, np.array([0, 90, 255])[INDICES]),
    "black and white": (Image.fromarray(GREY > 100), {}, 255 * (GREY > 100)),
}


@pytest.mark.parametrize(("picture", "options", "grey"), READ.values(), ids=READ)
def test_any_png_is_read_as_grey(tmp_path, picture, options, grey):
    read = read_picture(saved(tmp_path, picture, **options))
    assert read.dtype == np.float32
    assert np.array_equal(read, grey)


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
