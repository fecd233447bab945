"""Grey windows and colour maps, shared by all pictures."""

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary import ColorMap

Window = tuple[float, float]
MOST_LABELS = 7
# Percentiles of a log's grey window, chosen so that the ring of a dead cell does not darken the wood.
LOG_WINDOW = (0.5, 99.5)
NOT_FINITE = "a picture cannot show values that are not finite"
# Values that are converted at a time: what is computed on the way takes some 10 MB.
_STRIPE_VALUES = 2**18


def window_of(values: NDArray[np.floating[Any]], low: float = 0.1, high: float = 99.9) -> Window:
    """Return a window between two percentiles; of width 1 if all values are equal.

    Raises
    ------
    ValueError
        A value is not finite.
    """
    lowest, highest = (float(v) for v in np.percentile(values, (low, high)))
    if not (math.isfinite(lowest) and math.isfinite(highest)):
        raise ValueError(NOT_FINITE)
    return (lowest, highest) if highest > lowest else (lowest - 0.5, lowest + 0.5)


def to_unit(values: NDArray[np.floating[Any]], window: Window) -> NDArray[np.float64]:
    """Convert values to fractions of the window, clipped to 0..1."""
    low, high = window
    if not low < high:
        raise ValueError(f"a window must be (low, high) with low < high, not {window}")
    if not np.isfinite(values).all():
        raise ValueError(NOT_FINITE)
    return np.clip((np.asarray(values, dtype=np.float64) - low) / (high - low), 0.0, 1.0)


def stripes(values: NDArray[Any]) -> Iterator[slice]:
    """Yield stripes of an image's rows, to be converted one at a time: what is computed on the way takes memory."""
    step = max(1, _STRIPE_VALUES // values.shape[1])
    return (slice(first, first + step) for first in range(0, len(values), step))


def by_stripes(values: NDArray[Any], convert: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
    """Convert an image stripe by stripe."""
    return np.concatenate([convert(values[stripe]) for stripe in stripes(values)])


def labelled_views(angles_deg: NDArray[np.floating[Any]]) -> list[tuple[int, str]]:
    """Select views spread over a sinogram, each labelled with its own angle: views need not be equidistant."""
    views = len(angles_deg)
    shown = np.unique(np.linspace(0, views - 1, min(views, MOST_LABELS)).round().astype(int))
    return [(int(view), f"{angles_deg[view]:.4g}") for view in shown]


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

    return colormaps[color_map](np.arange(256), bytes=True)[:, :3]
