"""Corrections of a stack of line integrals, row by row of the detector: faulty cells, air, rings.

Rings are removed by sorting: Vo, Atwood and Drakopoulos, "Superior techniques for eliminating ring artifacts in X-ray
micro-tomography", Optics Express 26 (2018) 28396, algorithm 3.
"""

import math
from dataclasses import dataclass, field

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


def remove_rings(sinogram: NDArray[np.float32], window: int = WINDOW) -> NDArray[np.float32]:
    """Remove stripes from a sinogram (views, cells).

    Each cell's values are sorted; a cell's stripe is then next to its neighbours' values of the same rank, where a
    median along the detector removes it; then the values go back to their views. An object's own circles about the
    centre of rotation (growth rings of a log that turns about its pith) are stripes too, and are weakened.

    `sinogram` (views, cells) float32.
    """
    if window < 3 or window % 2 == 0:
        raise ValueError(f"window must be an odd number of cells from 3 on, not {window}")
    by_cell = np.ascontiguousarray(sinogram.T)
    order = np.argsort(by_cell, axis=1)
    ranked = np.take_along_axis(by_cell, order, axis=1)
    np.put_along_axis(by_cell, order, _median_along_cells(ranked.T, window).T, axis=1)
    return np.ascontiguousarray(by_cell.T)


def stripes(median: NDArray[np.floating]) -> float:
    """Return the robust standard deviation of single cells' stripes in a row, from its views' median (cells,)."""
    return robust_deviation(median - scipy.ndimage.median_filter(median, WINDOW, mode="nearest"))


def _median_along_cells(ranked: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Filter each rank (rank, cells) as one long line: eight times faster in SciPy than filtering a plane."""
    margin = window // 2
    padded = np.pad(ranked, ((0, 0), (margin, margin)), mode="edge")
    return scipy.ndimage.median_filter(padded.ravel(), window).reshape(padded.shape)[:, margin:-margin]


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
    air_cells: NDArray[np.bool_]  # (cells,) bool: air in every view of every row
    remarks: tuple[Reason, ...]  # one sentence for each correction that changed something, or could not be made


@dataclass
class _Findings:
    """Results of the rows so far."""

    faulty: NDArray[np.bool_]
    air_cells: NDArray[np.bool_]
    with_air: list[Air] = field(default_factory=list)
    without_air: int = 0
    stripes: list[tuple[float, float, bool]] = field(default_factory=list)


class RowCorrector:
    """Corrects a stack (views, rows, cells) of line integrals, some rows at a time.

    Each row is corrected independently, so rows may come in any portions.
    """

    def __init__(self, corrections: Corrections, rows: int, cells: int) -> None:
        self._corrections = corrections
        self._results = _Findings(np.zeros((rows, cells), bool), np.ones(cells, bool))

    def correct(self, stack: Stack, first_row: int = 0) -> None:
        """Correct rows from `first_row` on (views, rows, cells) in place; missing rows are NaN and stay so."""
        for row in range(stack.shape[1]):
            present = present_rows(stack[:, row])
            if present.any():
                sinogram = np.ascontiguousarray(stack[present, row])
                stack[present, row] = _corrected(sinogram, self._corrections, self._results, first_row + row)

    def result(self) -> CorrectedRows:
        """Return the result of the corrections of the rows so far."""
        return CorrectedRows(self._results.faulty, self._results.air_cells, _remarks(self._results, self._corrections))


def _corrected(sinogram: Sinogram, corrections: Corrections, results: _Findings, row: int) -> Sinogram:
    if corrections.bridge_faulty_cells and len(sinogram) >= FEWEST_VIEWS:
        results.faulty[row] = faulty_cells(sinogram, median_of_views(sinogram))
        if results.faulty[row].any():
            bridge(sinogram, results.faulty[row])
    if corrections.air is not AirCorrection.OFF:
        _subtract_air(sinogram, corrections, results)
    if len(sinogram) < FEWEST_VIEWS:
        return sinogram
    before = after = stripes(median_of_views(sinogram))
    if corrections.remove_rings:
        sinogram = remove_rings(sinogram)
        after = stripes(median_of_views(sinogram))
    results.stripes.append((before, after, _visible(before, sinogram)))
    return sinogram


def _subtract_air(sinogram: Sinogram, corrections: Corrections, results: _Findings) -> None:
    air = find_air(sinogram)
    if air is None or abs(air.background) > corrections.largest_air_level:
        results.without_air += 1
        results.air_cells[:] = False
        return
    sinogram -= air.correction(corrections.air)
    results.air_cells &= air.cells
    results.with_air.append(air)


def _visible(deviation: float, sinogram: Sinogram) -> bool:
    some = sinogram[:: max(1, len(sinogram) // 64)]
    low, high = np.quantile(some, [0.005, 0.995])
    noise_of_median = NOISE_OF_MEDIAN * noise_of_differences(np.diff(some, axis=1), 1) / math.sqrt(len(sinogram))
    return deviation > max(VISIBLE_STRIPES * float(high - low), 3.0 * noise_of_median)


def _remarks(results: _Findings, corrections: Corrections) -> tuple[Reason, ...]:
    return (*_of_cells(results), *_of_air(results, corrections), *_of_rings(results, corrections))


def _of_cells(results: _Findings) -> list[Reason]:
    if not results.faulty.any():
        return []
    return [PreparingMessage.FAULTY_CELLS(cells=int(results.faulty.sum()), rows=int(results.faulty.any(axis=1).sum()))]


def _of_air(results: _Findings, corrections: Corrections) -> list[Reason]:
    remarks: list[Reason] = []
    if results.with_air:
        levels = np.array([air.background for air in results.with_air])
        drifts = [air for air in results.with_air if air.drifts and corrections.air is AirCorrection.VIEWS]
        fewest = min(int(air.cells.sum()) for air in results.with_air)
        remarks.append(PreparingMessage.AIR_LEVEL(cells=fewest, rows=len(levels), level=float(levels.mean())))
        if drifts:
            spread = math.sqrt(np.mean([air.level.var() for air in drifts]))
            remarks.append(PreparingMessage.AIR_OF_VIEWS(rows=len(drifts), deviation=spread))
    if results.without_air:
        remarks.append(PreparingMessage.ROWS_WITHOUT_AIR(rows=results.without_air))
    return remarks


def _of_rings(results: _Findings, corrections: Corrections) -> list[Reason]:
    if not results.stripes:
        return []
    before, after = (float(np.median([row[side] for row in results.stripes])) for side in (0, 1))
    if corrections.remove_rings:
        return [PreparingMessage.RINGS_REMOVED(before=before, after=after, window=WINDOW)]
    visible = sum(row[2] for row in results.stripes)
    if 2 * visible <= len(results.stripes):
        return []
    return [PreparingMessage.RINGS_VISIBLE(before=before, rows=visible)]
