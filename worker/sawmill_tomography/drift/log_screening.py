"""Cells and views of a log's scan without a usable signal, those at the detector's ends included."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.faults.screening import Screening, screen
from sawmill_tomography.geometry.geometry import FloatArray

# Cells at either end of the detector are compared with this number of the next ones: `screen` compares a cell with its
# neighbours on both sides, which an end does not have.
END_CELLS, BESIDE = 4, 8
# A faulty cell in air departs from those cells by more than this number of their standard deviations, and by more than
# this share of the range (air.EDGE_SHARE): the flat field may slope.
DEPARTS, SHARE = 4.0, 0.003


def screen_log(sinogram: FloatArray) -> Screening:
    """Screen a log's scan (`screen`), including faulty cells at the detector's ends that look like a cut-off log."""
    screening = screen(sinogram)
    lines = screening.bridged(sinogram)[screening.views]
    # The range as `find_air` defines it.
    least = SHARE * float(np.ptp(np.quantile(lines[:: max(1, len(lines) // 64)], [0.005, 0.995])))
    cells = screening.cells.copy()
    cells[:END_CELLS] &= _sound(lines[:, : END_CELLS + BESIDE], least)
    cells[-END_CELLS:] &= _sound(lines[:, : -END_CELLS - BESIDE - 1 : -1], least)[::-1]
    return replace(screening, cells=cells)


def _sound(end: FloatArray, least: float) -> NDArray[np.bool_]:
    """Return which of the outermost `END_CELLS` cells have the level of their neighbours, for an end (views, cells)."""
    beside = end[:, END_CELLS:]
    level = beside.mean(axis=1, keepdims=True)
    noise = float(np.sqrt(np.mean((beside - level) ** 2)))
    departure = np.sqrt(np.mean((end[:, :END_CELLS] - level) ** 2, axis=0))
    sound: NDArray[np.bool_] = departure <= max(DEPARTS * noise, least)
    return sound
