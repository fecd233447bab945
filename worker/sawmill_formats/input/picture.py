"""Drawings of phantoms: PNG pictures as grey values."""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.input.arrays import HARMLESS_BYTES, LARGEST_RATIO
from sawmill_formats.input.contents import Part, PartKind

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
LARGEST_PICTURE_PIXELS = 64 * 2**20
# Most bytes a pixel while reading and tracing (tests/formats/input/test_bombs.py): grey values and their copy with a
# border as float32, and as the float64 in which contours are found.
BYTES_A_PIXEL = 18
MEMORY_SHARE = 0.9
# Bits of Pillow's modes; everything else has one byte for each band.
BITS = {"1": 1, "I;16": 16, "I;16B": 16, "I": 16}


def read_picture(path: Path, free_bytes: int | None = None) -> NDArray[np.float32]:
    """Read a PNG as grey values (rows, columns) float32; transparency is ignored.

    Parameters
    ----------
    path : Path
    free_bytes : int, optional
        Free memory, in which reading and tracing must fit.

    Raises
    ------
    UnreadableScan
        The file is no PNG, is damaged, or has more pixels than are read or fit into the memory.
    """
    if not is_picture(path):
        raise UnreadableScan("picture-not-png", "the phantom's picture is not a PNG file; export it as one")
    with opened_picture(path) as picture:
        width, height = picture.size
        needed = BYTES_A_PIXEL * width * height
        if needed > HARMLESS_BYTES and free_bytes is not None and needed > MEMORY_SHARE * free_bytes:
            raise UnreadableScan(
                "too-large",
                f"the picture has {width} x {height} pixels, and tracing them needs {needed} bytes of memory while "
                f"{free_bytes} are free; save it smaller",
            )
        return np.asarray(_grey(picture), np.float32)


def _grey(picture: Image.Image) -> Image.Image:
    """Remove transparency: a picture of one band has none, every other kind loses it by conversion to RGB."""
    if picture.mode in {"1", "L", "RGB"}:
        return picture.convert("L")
    return picture if picture.mode in BITS else picture.convert("RGB").convert("L")


def is_picture(path: Path) -> bool:
    """Return whether a file is a PNG, by its first bytes."""
    with path.open("rb") as stream:
        return stream.read(len(PNG_SIGNATURE)) == PNG_SIGNATURE


@contextmanager
def opened_picture(path: Path) -> Iterator[Image.Image]:
    """Open a PNG and check its size, without reading its pixels."""
    with library_errors_translated("PNG"), warnings.catch_warnings():
        warnings.simplefilter("error")  # Pillow only warns of decompression bombs
        with Image.open(path, formats=["PNG"]) as picture:
            width, height = picture.size
            if width * height > LARGEST_PICTURE_PIXELS:
                raise UnreadableScan(
                    "too-large", f"the picture has {width} x {height} pixels; give one of at most 64 million"
                )
            _check_stored(picture, path.stat().st_size)
            yield picture


def picture_parts(path: Path) -> Iterator[Part]:
    """Yield the one part of a PNG: rows and columns, and its bands."""
    with opened_picture(path) as picture:
        width, height = picture.size
        yield Part("the picture", PartKind.PICTURE, (height, width), picture.mode, None, path.stat().st_size, "deflate")


def _check_stored(picture: Image.Image, stored_bytes: int) -> None:
    width, height = picture.size
    # Each row starts with its filter's number.
    declared = height * (1 + math.ceil(width * BITS.get(picture.mode, 8 * len(picture.getbands())) / 8))
    if declared > max(HARMLESS_BYTES, LARGEST_RATIO * stored_bytes):
        raise UnreadableScan(
            "too-large",
            f"the picture has {declared} bytes of pixels and its file {stored_bytes}; above {HARMLESS_BYTES >> 20} MiB "
            f"it may be at most {LARGEST_RATIO} times as many: save the drawing in grey or smaller",
        )
