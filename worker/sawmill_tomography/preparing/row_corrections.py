"""Corrections of a stack of line integrals, row by row of the detector: faulty cells, air, rings.

Rings are removed by sorting: Vo, Atwood and Drakopoulos, "Superior techniques for eliminating ring artifacts in X-ray
micro-tomography", Optics Express 26 (2018) 28396, algorithm 3.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.sinograms.air import Air, DecidedAirCorrection, faulty_cells, find_air, median_of_views
from sawmill_tomography.sinograms.present_rows import bridge, present_rows
from sawmill_tomography.statistics import noise_of_differences, robust_deviation
from sawmill_vocabulary import AirCorrection
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import PreparingMessage

# Width of the median, in cells. The publication's 21 is for finer detectors: it harms a log three times as much as 9
# (benchmarks/preparing.py at 3ab7f653).
WINDOW = 9


def remove_rings(sinogram: NDArray[np.float32]) -> NDArray[np.float32]:
    """Remove stripes from a sinogram (views, cells).

    Each cell's values are sorted; a cell's stripe is then next to its neighbours' values of the same rank, where a
    median along the detector removes it; then the values go back to their views. An object's own circles about the
    centre of rotation (growth rings of a log that turns about its pith) are stripes too, and are weakened.

    `sinogram` (views, cells) float32.
    """
    by_cell = np.ascontiguousarray(sinogram.T)
    order = np.argsort(by_cell, axis=1)
    ranked = np.take_along_axis(by_cell, order, axis=1)
    np.put_along_axis(by_cell, order, _median_along_cells(ranked.T).T, axis=1)
    return np.ascontiguousarray(by_cell.T)


def stripes(median: NDArray[np.floating]) -> float:
    """Return the robust standard deviation of single cells' stripes in a row, from its views' median (cells,)."""
    return robust_deviation(median - scipy.ndimage.median_filter(median, WINDOW, mode="nearest"))


def _median_along_cells(ranked: NDArray[np.float32]) -> NDArray[np.float32]:
    """Filter each rank (rank, cells) as one long line: eight times faster in SciPy than filtering a plane."""
    margin = WINDOW // 2
    padded = np.pad(ranked, ((0, 0), (margin, margin)), mode="edge")
    return scipy.ndimage.median_filter(padded.ravel(), WINDOW).reshape(padded.shape)[:, margin:-margin]


Sinogram = NDArray[np.float32]
Stack = NDArray[np.float32]

# Cells of a row with fewer views are neither judged nor evened out; a single view shows where the air is.
FEWEST_VIEWS = 3
# Stripes are visible beyond this share of the row's range, and beyond the noise of a median over the views,
# whose standard deviation is sqrt(pi / 2) of the mean's (tests/tomography/preparing/test_row_corrections.py).
VISIBLE_STRIPES, NOISE_OF_MEDIAN = 0.003, 1.25


@dataclass(frozen=True)
class Corrections:
    """Corrections to make."""

    air: DecidedAirCorrection
    # A higher level, as a line integral, is not air but something in the beam; such a row is not corrected
    largest_air_level: float = math.inf
    bridge_faulty_cells: bool = True
    remove_rings: bool = False

    @property
    def none(self) -> bool:
        """True if there is nothing to correct."""
        return self.air is AirCorrection.OFF and not self.bridge_faulty_cells and not self.remove_rings


@dataclass(frozen=True, eq=False)
class CorrectedRows:
    """Result of the corrections."""

    faulty: NDArray[np.bool_]  # (rows, cells) bool: cells that were bridged
    remarks: tuple[Reason, ...]  # one sentence for each correction that changed something, or could not be made


class RowCorrector:
    """Corrects a stack (views, rows, cells) of line integrals, some rows at a time.

    Each row is corrected independently, so rows may come in any portions.
    """

    def __init__(self, corrections: Corrections, rows: int, cells: int) -> None:
        self._corrections = corrections
        self._faulty = np.zeros((rows, cells), bool)
        self._with_air: list[Air] = []
        self._without_air = 0
        # Of each row, the stripes before and after the removal of rings, and whether the former are visible.
        self._stripes: list[tuple[float, float, bool]] = []

    def correct(self, stack: Stack, first_row: int = 0) -> None:
        """Correct rows from `first_row` on (views, rows, cells) in place; missing rows are NaN and stay so."""
        for row in range(stack.shape[1]):
            present = present_rows(stack[:, row])
            if present.any():
                stack[present, row] = self._corrected(np.ascontiguousarray(stack[present, row]), first_row + row)

    def _corrected(self, sinogram: Sinogram, row: int) -> Sinogram:
        if self._corrections.bridge_faulty_cells and len(sinogram) >= FEWEST_VIEWS:
            self._faulty[row] = faulty_cells(sinogram, median_of_views(sinogram))
            if self._faulty[row].any():
                bridge(sinogram, self._faulty[row])
        if self._corrections.air is not AirCorrection.OFF:
            self._subtract_air(sinogram)
        if len(sinogram) < FEWEST_VIEWS:
            return sinogram
        before = after = stripes(median_of_views(sinogram))
        if self._corrections.remove_rings:
            sinogram = remove_rings(sinogram)
            after = stripes(median_of_views(sinogram))
        self._stripes.append((before, after, _visible(before, sinogram)))
        return sinogram

    def _subtract_air(self, sinogram: Sinogram) -> None:
        air = find_air(sinogram)
        if air is None or abs(air.background) > self._corrections.largest_air_level:
            self._without_air += 1
            return
        sinogram -= air.correction(self._corrections.air)
        self._with_air.append(air)

    def result(self) -> CorrectedRows:
        """Return the result of the corrections of the rows so far."""
        remarks: list[Reason] = []
        if self._faulty.any():
            cells, rows = int(self._faulty.sum()), int(self._faulty.any(axis=1).sum())
            remarks.append(PreparingMessage.FAULTY_CELLS(cells=cells, rows=rows))
        if self._with_air:
            level = float(np.mean([air.background for air in self._with_air]))
            fewest = min(int(air.cells.sum()) for air in self._with_air)
            remarks.append(PreparingMessage.AIR_LEVEL(cells=fewest, rows=len(self._with_air), level=level))
        drifts = [air for air in self._with_air if air.drifts and self._corrections.air is AirCorrection.VIEWS]
        if drifts:
            spread = math.sqrt(np.mean([air.level.var() for air in drifts]))
            remarks.append(PreparingMessage.AIR_OF_VIEWS(rows=len(drifts), deviation=spread))
        if self._without_air:
            remarks.append(PreparingMessage.ROWS_WITHOUT_AIR(rows=self._without_air))
        if self._stripes:
            before, after = (float(np.median([row[side] for row in self._stripes])) for side in (0, 1))
            visible = sum(row[2] for row in self._stripes)
            if self._corrections.remove_rings:
                remarks.append(PreparingMessage.RINGS_REMOVED(before=before, after=after, window=WINDOW))
            elif 2 * visible > len(self._stripes):
                remarks.append(PreparingMessage.RINGS_VISIBLE(before=before, rows=visible))
        return CorrectedRows(self._faulty, tuple(remarks))


def _visible(deviation: float, sinogram: Sinogram) -> bool:
    some = sinogram[:: max(1, len(sinogram) // 64)]
    low, high = np.quantile(some, [0.005, 0.995])
    noise_of_median = NOISE_OF_MEDIAN * noise_of_differences(np.diff(some, axis=1), 1) / math.sqrt(len(sinogram))
    return deviation > max(VISIBLE_STRIPES * float(high - low), 3.0 * noise_of_median)
