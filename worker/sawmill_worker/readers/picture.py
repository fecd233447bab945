"""Drawings of phantoms: PNG pictures as grey values."""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sawmill_worker.files.errors import UnreadableScan, library_errors_translated
from sawmill_worker.readers.arrays import HARMLESS_BYTES, LARGEST_RATIO
from sawmill_worker.readers.parts import Part, PartKind

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
LARGEST_PICTURE_PIXELS = 64 * 2**20
# Of those bits deep; everything else has one byte for each of its bands.
BITS = {"1": 1, "I;16": 16, "I;16B": 16, "I": 16}


def read_picture(path: Path) -> NDArray[np.float32]:
    """Read a PNG as grey values (rows, columns) float32; transparency is ignored.

    Raises
    ------
    UnreadableScan
        The file is no PNG, is damaged, or has more than 64 million pixels.
    """
    if not is_picture(path):
        raise UnreadableScan("unknown-format", "the phantom's picture is not a PNG file; export it as one")
    with opened_picture(path) as picture:
        # A 16-bit picture has no transparency; every other kind goes by way of RGB, which drops it.
        grey = picture if picture.mode.startswith("I") else picture.convert("RGB").convert("L")
        return np.asarray(grey, np.float32)


def is_picture(path: Path) -> bool:
    """Whether a file is a PNG, by its first bytes."""
    with path.open("rb") as stream:
        return stream.read(len(PNG_SIGNATURE)) == PNG_SIGNATURE


@contextmanager
def opened_picture(path: Path) -> Iterator[Image.Image]:
    """Open a PNG whose size was looked at, its pixels not yet read.

    Raises
    ------
    UnreadableScan
        The file is damaged, or has more than 64 million pixels.
    """
    with library_errors_translated("PNG"), warnings.catch_warnings():
        warnings.simplefilter("error")  # Pillow only warns of pictures that are bombs
        with Image.open(path, formats=["PNG"]) as picture:
            width, height = picture.size
            if width * height > LARGEST_PICTURE_PIXELS:
                raise UnreadableScan(
                    "too-large", f"the picture has {width} x {height} pixels; give one of at most 64 million"
                )
            _check_stored(picture, path.stat().st_size)
            yield picture


def picture_parts(path: Path) -> Iterator[Part]:
    """The one part of a PNG: rows and columns, and its bands."""
    with opened_picture(path) as picture:
        width, height = picture.size
        stored = path.stat().st_size
        yield Part("the picture", PartKind.PICTURE, (height, width), picture.mode, None, stored, "deflate")


def _check_stored(picture: Image.Image, stored_bytes: int) -> None:
    width, height = picture.size
    row_bytes = math.ceil(width * BITS.get(picture.mode, 8 * len(picture.getbands())) / 8)
    declared = height * (1 + row_bytes)  # each row begins with the number of its filter
    if declared > max(HARMLESS_BYTES, LARGEST_RATIO * stored_bytes):
        raise UnreadableScan(
            "too-large",
            f"the picture has {declared} bytes of pixels and its file {stored_bytes}; above {HARMLESS_BYTES >> 20} MiB "
            f"it may be at most {LARGEST_RATIO} times as many: save the drawing in grey or smaller",
        )
