"""The air next to the object, its level in each view, and dead and hot cells, in one row's sinogram.

Beyond the object every line integral is zero. A measured value there is the drift of the source since the flat fields
were taken, or a constant that was added.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sawmill_tomography.statistics import noise_of_differences, robust_deviation
from sawmill_vocabulary import AirCorrection

Sinogram = NDArray[np.float32]
# A decided correction: `auto` has been resolved earlier, where the kind of data is known.
DecidedAirCorrection = Literal[AirCorrection.OFF, AirCorrection.BACKGROUND, AirCorrection.VIEWS]

# Number of outermost cells, whose median is the level with which further cells are compared.
OUTERMOST = 8
SMOOTHED = 5
# Smoothed air departs from this level by no more than this number of its noise's standard deviations: in all but one of
# 500 rows, of a million samples each (tests/tomography/test_air.py).
DEVIATIONS = 6.0
# Below this share of the range an object's edge looks like unequal cells, and does no harm.
EDGE_SHARE, UNEQUAL_SHARE = 0.003, 0.02
# An end whose level is above the other's by this share of the range is wood: the growth rings of a log that is cut off
# look like noise.
WOOD_SHARE = 0.1
# Cells left out next to an object's shadow, whose foot is below the threshold.
MARGIN = 3
# A level drifts if its variance exceeds the variance by its noise by more than this factor.
DRIFTING = 2.0


@dataclass(frozen=True, eq=False)
class Air:
    """The air of one row."""

    cells: NDArray[np.bool_]  # (cells,) bool: True for air in every view
    level: NDArray[np.float64]  # (views,): mean of the line integrals over these cells
    noise: float  # standard deviation of one sample in air

    @property
    def background(self) -> float:
        """Level common to all views."""
        return float(self.level.mean())

    @property
    def drifts(self) -> bool:
        """True if the level varies between views by more than its own noise explains."""
        return float(self.level.var()) > DRIFTING * self.noise**2 / int(self.cells.sum())

    def correction(self, correction: DecidedAirCorrection) -> NDArray[np.float32]:
        """Return the level to subtract from each view (views, 1)."""
        if correction is AirCorrection.OFF:
            return np.zeros((self.level.size, 1), np.float32)
        by_view = correction is AirCorrection.VIEWS and self.drifts
        return (self.level if by_view else np.full_like(self.level, self.background)).astype(np.float32)[:, None]


def find_air(sinogram: Sinogram) -> Air | None:
    """Find the air at both ends of a row's detector cells; None where the object reaches the ends.

    An end's air is the run of cells that keep the outermost cells' level in every view. An end that the object covers
    in some views has no such run, since a shadow slopes.

    Parameters
    ----------
    sinogram : (views, cells) float32
        Line integrals without faulty cells.
    """
    half = sinogram.shape[1] // 2
    # The range is the object's; every sixty-fourth view shows it.
    span = float(np.ptp(np.quantile(sinogram[:: max(1, len(sinogram) // 64)], [0.005, 0.995])))
    left, noise_left = _run(sinogram[:, :half], span)
    right, noise_right = _run(sinogram[:, : -half - 1 : -1], span)
    if left and right:
        higher = float(np.median(sinogram[:, :OUTERMOST])) - float(np.median(sinogram[:, -OUTERMOST:]))
        if abs(higher) > max(WOOD_SHARE * span, DEVIATIONS * max(noise_left, noise_right)):
            left, right = (0, right) if higher > 0.0 else (left, 0)
    if not left and not right:
        return None
    cells = np.zeros(sinogram.shape[1], bool)
    cells[:left] = True
    cells[cells.size - right :] = True
    level = sinogram[:, cells].mean(axis=1, dtype=np.float64)
    return Air(cells, level, math.sqrt((left * noise_left**2 + right * noise_right**2) / (left + right)))


def _run(end: Sinogram, span: float) -> tuple[int, float]:
    """Return the number of air cells at one end, from the outermost on, and the standard deviation of their noise."""
    if end.shape[1] < OUTERMOST + MARGIN:
        return 0, 0.0
    departure = end - np.median(end[:, :OUTERMOST], axis=1, keepdims=True)
    unequal = median_of_views(departure)
    departure -= unequal
    # Second differences along the detector contain neither drift nor a smooth object.
    noise = noise_of_differences(np.diff(departure[:, : 4 * OUTERMOST], 2, axis=1), 2)
    threshold = max(DEVIATIONS * noise * math.sqrt(1.0 / SMOOTHED + 1.57 / OUTERMOST), EDGE_SHARE * span)
    moved = np.abs(scipy.ndimage.uniform_filter1d(departure, SMOOTHED, axis=1, mode="nearest")).max(axis=0)
    object_here = (moved > threshold) | (np.abs(unequal) > UNEQUAL_SHARE * span + 3.0 * noise)
    first = int(np.argmax(object_here)) if object_here.any() else object_here.size + MARGIN
    return max(first - MARGIN, 0) if first - MARGIN >= OUTERMOST else 0, noise


Cells = NDArray[np.bool_]

# A cell is faulty if its middle value departs from its neighbours' by this number of robust standard deviations, and by
# this share of the row's range. A shadow's edge departs less: a median filter keeps edges
# (tests/tomography/test_faulty_cells.py; test_adjust.py for scans of the phantom).
FAULTY_DEVIATIONS, SHARE_OF_RANGE = 20.0, 0.06
# Width of the median filter, in cells.
NEIGHBOURS = 11
# If more cells than this share are found, they are the object's structure and not faults
# (tests/tomography/test_faulty_cells.py).
MOST_FAULTY = 0.05


def median_of_views(sinogram: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the median over the views (cells,) of a sinogram (views, cells): the upper one of an even number."""
    return np.sort(np.ascontiguousarray(sinogram.T), axis=1)[:, len(sinogram) // 2]


def faulty_cells(
    sinogram: NDArray[np.floating],
    median: NDArray[np.floating],
    *,
    recheck: bool = True,
    most_faulty: float = MOST_FAULTY,
) -> Cells:
    """Find cells that differ from their neighbours, or never change between cells that do.

    `sinogram` (views, cells), line integrals. `median` (cells,): median of each cell over the views. Returns (cells,)
    bool.
    """
    changing = np.ptp(sinogram, axis=0) > 0.0
    if not changing.any():
        return np.zeros(changing.size, bool)
    middle = median + sinogram.mean(axis=0)
    departure = np.abs(middle - _median_filter(middle))
    low, high = np.quantile(middle, [0.02, 0.98])
    threshold = max(FAULTY_DEVIATIONS * robust_deviation(departure), SHARE_OF_RANGE * float(high - low))
    faulty: Cells = departure > threshold
    if recheck and faulty.any() and not faulty.all():
        at = np.arange(faulty.size)
        faulty &= np.abs(middle - _median_filter(np.interp(at, at[~faulty], middle[~faulty]))) > threshold
    # Air may be free of noise: a cell without changes has no signal only where it lies between cells that change.
    first, last = np.flatnonzero(changing)[[0, -1]]
    faulty[first : last + 1] |= ~changing[first : last + 1]
    return faulty if faulty.mean() <= most_faulty else np.zeros_like(faulty)


def _median_filter(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Take the median of `NEIGHBOURS` cells around each; importing `scipy.ndimage`'s would delay a calibration."""
    windows = sliding_window_view(np.pad(values, NEIGHBOURS // 2, mode="edge"), NEIGHBOURS)
    return np.sort(windows, axis=1)[:, NEIGHBOURS // 2]
