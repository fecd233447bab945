"""What is done to a stack of line integrals before it is used: faulty cells, air, rings; row by row of the detector."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.tomography.air import Air, find_air
from sawmill_worker.tomography.preparing.bridging import bridge
from sawmill_worker.tomography.preparing.faulty_cells import Sinogram, faulty_cells, middle_of_views
from sawmill_worker.tomography.preparing.ring_removal import WINDOW, remove_rings, stripes
from sawmill_worker.vocabulary import AirCorrection

Stack = NDArray[np.float32]

# A row seen by fewer views says too little of its cells; its air is known in one.
FEWEST_VIEWS = 3
# Stripes that a picture shows: this share of the row's range, and more than noise leaves in a median over the views.
VISIBLE_STRIPES, NOISE_OF_MEDIAN = 0.003, 1.25


@dataclass(frozen=True)
class Measures:
    """What is to be done.

    Attributes
    ----------
    air : AirCorrection
    largest_air_level : float
        A level beyond it, as a line integral, is no air but something in the beam, and the row keeps it.
    bridge_faulty_cells, remove_rings : bool
    """

    air: AirCorrection
    largest_air_level: float = math.inf
    bridge_faulty_cells: bool = True
    remove_rings: bool = False

    @property
    def none(self) -> bool:
        """Whether there is nothing to do."""
        return self.air is AirCorrection.OFF and not self.bridge_faulty_cells and not self.remove_rings


@dataclass(frozen=True, eq=False)
class PreparedRows:
    """What was done.

    Attributes
    ----------
    faulty : (rows, cells) bool
        Cells that were bridged.
    air_cells : (cells,) bool
        Air in every view of every row.
    remarks : tuple of str
        One sentence for each measure that did something, or could not.
    """

    faulty: NDArray[np.bool_]
    air_cells: NDArray[np.bool_]
    remarks: tuple[str, ...]


@dataclass
class _Findings:
    """Of each row, as they come."""

    faulty: NDArray[np.bool_]
    air_cells: NDArray[np.bool_]
    with_air: list[Air] = field(default_factory=list)
    without_air: int = 0
    stripes: list[tuple[float, float, bool]] = field(default_factory=list)


class Preparation:
    """A stack (views, rows, cells) of line integrals being prepared, some rows at a time.

    Each row is treated by itself, so that it does not matter which rows come together.
    """

    def __init__(self, measures: Measures, rows: int, cells: int) -> None:
        self._measures = measures
        self._found = _Findings(np.zeros((rows, cells), bool), np.ones(cells, bool))

    def treat(self, stack: Stack, first_row: int = 0) -> None:
        """Prepare rows from `first_row` on (views, rows, cells) in place; missing rows are NaN and stay so."""
        for row in range(stack.shape[1]):
            there = ~np.isnan(stack[:, row, 0])
            if there.any():
                sinogram = np.ascontiguousarray(stack[there, row])
                stack[there, row] = _prepared(sinogram, self._measures, self._found, first_row + row)

    def done(self) -> PreparedRows:
        """What was done to the rows that were treated."""
        return PreparedRows(self._found.faulty, self._found.air_cells, _remarks(self._found, self._measures))


def _prepared(sinogram: Sinogram, measures: Measures, found: _Findings, row: int) -> Sinogram:
    if measures.bridge_faulty_cells and len(sinogram) >= FEWEST_VIEWS:
        found.faulty[row] = faulty_cells(sinogram)
        if found.faulty[row].any():
            bridge(sinogram, found.faulty[row])
    if measures.air is not AirCorrection.OFF:
        _take_out_air(sinogram, measures, found)
    if len(sinogram) < FEWEST_VIEWS:
        return sinogram
    before = after = stripes(middle_of_views(sinogram))
    if measures.remove_rings:
        sinogram = remove_rings(sinogram)
        after = stripes(middle_of_views(sinogram))
    found.stripes.append((before, after, _visible(before, sinogram)))
    return sinogram


def _take_out_air(sinogram: Sinogram, measures: Measures, found: _Findings) -> None:
    air = find_air(sinogram)
    if air is None or abs(air.background) > measures.largest_air_level:
        found.without_air += 1
        found.air_cells[:] = False
        return
    sinogram -= air.correction(measures.air)
    found.air_cells &= air.cells
    found.with_air.append(air)


def _visible(deviation: float, sinogram: Sinogram) -> bool:
    some = sinogram[:: max(1, len(sinogram) // 64)]
    low, high = np.quantile(some, [0.005, 0.995])
    noise = 1.4826 * float(np.median(np.abs(np.diff(some, axis=1)))) / math.sqrt(2.0)
    of_noise = NOISE_OF_MEDIAN * noise / math.sqrt(len(sinogram))
    return deviation > max(VISIBLE_STRIPES * float(high - low), 3.0 * of_noise)


def _remarks(found: _Findings, measures: Measures) -> tuple[str, ...]:
    return (*_of_cells(found), *_of_air(found, measures), *_of_rings(found, measures))


def _of_cells(found: _Findings) -> list[str]:
    if not found.faulty.any():
        return []
    rows = int(found.faulty.any(axis=1).sum())
    return [f"{int(found.faulty.sum())} dead or hot detector cells in {rows} rows bridged from their neighbours"]


def _of_air(found: _Findings, measures: Measures) -> list[str]:
    told = []
    if found.with_air:
        levels = np.array([air.background for air in found.with_air])
        drifts = [air for air in found.with_air if air.drifts and measures.air is AirCorrection.VIEWS]
        fewest = min(int(air.cells.sum()) for air in found.with_air)
        told.append(
            f"air level in at least {fewest} cells at the detector's ends taken out of {len(levels)} rows: "
            f"{levels.mean():.2g} in the mean"
        )
        if drifts:
            spread = math.sqrt(np.mean([air.level.var() for air in drifts]))
            told.append(f"in {len(drifts)} rows view by view, where it varied by {spread:.2g} (standard deviation)")
    if found.without_air:
        told.append(f"{found.without_air} rows without air at the detector's ends keep their level")
    return told


def _of_rings(found: _Findings, measures: Measures) -> list[str]:
    if not found.stripes:
        return []
    before, after = (float(np.median([row[side] for row in found.stripes])) for side in (0, 1))
    if measures.remove_rings:
        told = f"{WINDOW} cells): stripes were {before:.2g} and are {after:.2g} (median of the rows)"
        return [f"rings removed by sorting (Vo, Atwood and Drakopoulos 2018, algorithm 3, {told}"]
    visible = sum(row[2] for row in found.stripes)
    if 2 * visible <= len(found.stripes):
        return []
    return [f"unequal cells leave stripes of {before:.2g} in {visible} rows, seen as rings; rings=sorting removes them"]
