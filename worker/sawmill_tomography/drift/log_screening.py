"""Cells and views of a log's scan without a usable signal, those at the detector's ends included."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.faults.screening import Screening, screen
from sawmill_tomography.geometry.geometry import FloatArray

# Cells at either end of the detector are compared with this number of the next ones: `screen` compares a cell with its
# neighbours on both sides, which an end does not have.
END_CELLS, BESIDE = 4, 8
# A cell in air departs from those by no more than this number of their standard deviations, or this share of the range
# (air.EDGE_SHARE): the flat field may slope.
DEPARTS, SHARE = 4.0, 0.003


def screen_log(sinogram: FloatArray) -> Screening:
    """As `screen`, with faulty cells at the ends of the detector, which would pass for a log that reaches them."""
    screening = screen(sinogram)
    lines = screening.bridged(sinogram)[screening.views]
    # As `find_air` has the range.
    least = SHARE * float(np.ptp(np.quantile(lines[:: max(1, len(lines) // 64)], [0.005, 0.995])))
    cells = screening.cells.copy()
    cells[:END_CELLS] &= _sound(lines[:, : END_CELLS + BESIDE], least)
    cells[-END_CELLS:] &= _sound(lines[:, : -END_CELLS - BESIDE - 1 : -1], least)[::-1]
    return replace(screening, cells=cells)


def _sound(end: FloatArray, least: float) -> NDArray[np.bool_]:
    """Which of the outermost `END_CELLS` cells have the level of those beside them, of an end (views, cells)."""
    beside = end[:, END_CELLS:]
    level = beside.mean(axis=1, keepdims=True)
    noise = float(np.sqrt(np.mean((beside - level) ** 2)))
    departure = np.sqrt(np.mean((end[:, :END_CELLS] - level) ** 2, axis=0))
    sound: NDArray[np.bool_] = departure <= max(DEPARTS * noise, least)
    return sound
