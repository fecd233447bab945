"""Colour maps for pictures: grey, and three perceptually uniform maps of matplotlib."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary import ColorMap
from sawmill_worker.pictures.windows import Window, by_stripes, to_unit


def shaded(values: NDArray[np.floating[Any]], window: Window, color_map: ColorMap = ColorMap.GREY) -> NDArray[np.uint8]:
    """Convert values of a two-dimensional image to 8-bit grey or colours, as `painted` does fractions."""
    return by_stripes(values, lambda stripe: painted(to_unit(stripe, window), color_map))


def painted(fractions: NDArray[np.floating[Any]], color_map: ColorMap) -> NDArray[np.uint8]:
    """Convert fractions 0..1 of a window to 8-bit grey of the same shape, or to colours (..., 3)."""
    steps: NDArray[np.uint8] = np.rint(fractions * 255).astype(np.uint8)
    return steps if color_map is ColorMap.GREY else np.take(color_table(color_map), steps, axis=0)


@cache
def color_table(color_map: ColorMap) -> NDArray[np.uint8]:
    """Return the map's 256 colours, (256, 3), from the window's low end to its high end."""
    if color_map is ColorMap.GREY:
        return np.arange(256, dtype=np.uint8)[:, np.newaxis].repeat(3, axis=1)
    # Imported here because a grey picture needs no matplotlib, whose colour maps alone take half a second to import.
    from matplotlib import colormaps  # noqa: PLC0415

    table: NDArray[np.uint8] = colormaps[color_map](np.arange(256), bytes=True)[:, :3]
    return table
