"""Colour maps for pictures: grey, and three in which equal steps of a value look like equal steps.

viridis, inferno and magma are those of N. Smith and S. van der Walt (2015, in the public domain by CC0), kept as 33
colours between which is interpolated: at most two of 255 steps away from their tables.
"""

from enum import StrEnum
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray


class ColorMap(StrEnum):
    """How a picture shows values, from low to high."""

    GREY = "grey"
    VIRIDIS = "viridis"
    INFERNO = "inferno"
    MAGMA = "magma"


_COLORS = MappingProxyType(
    {
        ColorMap.VIRIDIS: (
            "440154 470d60 48186a 482374 472d7b 453781 424086 3e4989 3b528b 375b8d 33638d "
            "2f6b8e 2c728e 297a8e 26828e 23898e 21918c 1f978b 1f9f88 21a685 27ad81 31b57b "
            "3dbc74 4cc26c 5cc863 6ece58 81d34d 95d840 aadc32 c0df25 d5e21a eae51a fde725"
        ),
        ColorMap.INFERNO: (
            "000004 040312 0b0724 150b37 210c4a 2f0a5b 3d0965 4a0c6b 57106e 64156e 71196e "
            "7d1e6d 8a226a 972766 a32c61 b0315b bc3754 c63d4d d04545 da4e3c e35933 eb6429 "
            "f1711f f67e14 f98c0a fb9b06 fcaa0f fbba1f f9c932 f5d949 f2e865 f3f586 fcffa4"
        ),
        ColorMap.MAGMA: (
            "000004 030312 0a0822 130d34 1d1147 29115a 36106b 440f76 51127c 5d177f 6a1c81 "
            "762181 832681 902a81 9c2e7f aa337d b73779 c23b75 cf4070 db476a e55064 ee5b5e "
            "f4695c f9785d fb8761 fd9668 fea571 feb47b fec287 fed194 fde0a1 fceeb0 fcfdbf"
        ),
    }
)


def painted(fractions: NDArray[np.floating[Any]], color_map: ColorMap) -> NDArray[np.uint8]:
    """Fractions 0..1 of a window as 8-bit grey, of their own shape, or as colours, (..., 3)."""
    steps: NDArray[np.uint8] = np.rint(fractions * 255).astype(np.uint8)
    return steps if color_map is ColorMap.GREY else np.take(_table(color_map), steps, axis=0)


@cache
def _table(color_map: ColorMap) -> NDArray[np.uint8]:
    """The map's 256 colours, (256, 3)."""
    colors = np.array([list(bytes.fromhex(color)) for color in _COLORS[color_map].split()])
    at = np.rint(np.linspace(0, 255, len(colors)))
    channels = [np.interp(np.arange(256), at, channel) for channel in colors.T]
    table: NDArray[np.uint8] = np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
    return table
