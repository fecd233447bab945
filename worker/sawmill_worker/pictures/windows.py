"""Grey windows, shared by all pictures."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
