"""Modules of the detector: a gap or a kink before some cell, which moves all cells on one side of it."""

import math
from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from sawmill_tomography.calibration.elimination import scaled_inverse
from sawmill_tomography.calibration.faults.effects import Effect
from sawmill_tomography.calibration.joint_fit.normal_equations import Column, System, ViewGrams
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, gap_term, kink_term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment, DetectorModule
from sawmill_vocabulary.scan_messages import EffectMessage

# A module has at least this many cells.
FEWEST_CELLS = 8
# A scan that is far from its model for other reasons would show larger gaps and kinks than any detector has.
LARGEST_GAP_CELLS, LARGEST_KINK_RAD = 4.0, 0.07
# A border is looked for this number of cells away from where it was found.
REACH = 4
# A module that stands in for another may begin this number of cells away from it.
NEAR = 16
# The information about a gap or a kink that the other unknowns must leave, as a share of the whole detector's.
LEAST_SEEN = 1e-3
# The share of all information about u_c that cells on either side of a border must have.
LEAST_BESIDE = 0.01


def effect_of(module: DetectorModule, cell_mm: float) -> Effect:
    """Return the effect of a module's gap and kink, which start from the given ones; cells are `cell_mm` wide."""
    return Effect(
        Adjustment.MODULES,
        lambda _: (Column.of(gap_term(module.first_cell)), Column.of(kink_term(module.first_cell))),
        lambda _, sizes: EffectMessage.MODULE(
            cell=module.first_cell,
            gap_mm=module.gap_mm + float(sizes[0]),
            angle_deg=math.degrees(module.kink_rad + sizes[1]),
        ),
        possible=lambda _, sizes: abs(sizes[0]) <= LARGEST_GAP_CELLS * cell_mm and abs(sizes[1]) <= LARGEST_KINK_RAD,
    )


def with_module(model: ScanModel, module: DetectorModule) -> ScanModel:
    """Return the model with one more module."""
    cells = model.data.cells
    modules = sorted((*cells.modules, module), key=lambda one: one.first_cell)
    return replace(model, data=replace(model.data, cells=replace(cells, modules=tuple(modules))))


def with_modules(model: ScanModel, kept: Collection[int]) -> ScanModel:
    """Return the model with the modules whose first cells are kept."""
    cells = model.data.cells
    modules = tuple(module for module in cells.modules if module.first_cell in kept)
    return replace(model, data=replace(model.data, cells=replace(cells, modules=modules)))


class ModuleSearch:
    """The power that a gap or a kink before each cell explains next to the columns of a fit.

    Columns of poses that change from view to view are left out of the comparison: the test of an effect has them all.
    Cells near the borders of known modules, and of modules that were not needed (`avoided`), are left out.
    """

    def __init__(
        self, model: ScanModel, grams: ViewGrams, system: System, used: list[int], avoided: Collection[int]
    ) -> None:
        places = [place for place in used if system.columns[place].term is not None]
        self._terms = [system.columns[place].term for place in places]
        self._with_columns, self._own, self._score = grams.by_cell([system.columns[place] for place in places])
        self._normal, self._of_base = system.normal[np.ix_(places, places)], system.score[places]
        cells, (self._u, self._turn) = model.data.cells, model.by_kink
        self._taken = [*avoided, *(module.first_cell for module in cells.modules)]
        self._border = cells.first_border_mm + cells.width_mm * np.arange(cells.count)

    def likeliest(self, least_power: float, most: int) -> list[int]:
        """Find the cells before which a gap or a kink explains more than this power.

        The cells are found one after another, each next to the ones before; then each again next to the others. A gap
        and a kink together would stand in for the modules that are not found yet.
        """
        found: list[int] = []
        while len(found) < most:
            cell, power = self._best(found)
            if power < least_power:
                break
            found.append(cell)
        for number in range(len(found) if len(found) > 1 else 0):
            found[number], _ = self._best(found[:number] + found[number + 1 :])
        return sorted(set(found))

    def relocated(self, module: DetectorModule, least_power: float) -> int:
        """Return the cell near a module's first cell before which the module explains more by more than this power.

        It is the first cell where there is none. What a module far away explains is not known to first order.
        """
        power, cell = self._without(module)._powers([], least_power), module.first_cell  # noqa: SLF001 - its own class
        first = max(cell - NEAR, 0)
        best = first + int(power[first : cell + NEAR + 1].argmax())
        return best if power[best] > power[cell] + least_power else cell

    def _without(self, module: DetectorModule) -> "ModuleSearch":
        """Return, to first order, the search without a module that the fit found."""
        rest, cell = copy(self), module.first_cell
        kept = [n for n, term in enumerate(self._terms) if term not in {gap_term(cell), kink_term(cell)}]
        shape = np.array([-module.gap_mm, module.kink_rad]) @ self._shapes(cell)
        rest._with_columns, rest._normal = self._with_columns[kept], self._normal[np.ix_(kept, kept)]  # noqa: SLF001
        rest._score, rest._of_base = self._score + self._own * shape, (self._of_base + self._with_columns @ shape)[kept]  # noqa: SLF001
        rest._taken = [taken for taken in self._taken if taken != cell]  # noqa: SLF001
        return rest

    def border(self, module: DetectorModule, variance: float) -> tuple[int, float]:
        """Return the likeliest cell before which a module begins, and the variance of the place, cells squared.

        Cells at most `REACH` away are compared. A cell that changes sides moves by the gap: its part of the residual's
        power changes by the square of the gap times the power of the derivative by u_c, less twice the gap times the
        score.
        """
        cell, gap_mm = module.first_cell, module.gap_mm
        score = self._score - np.linalg.lstsq(self._normal, self._of_base)[0] @ self._with_columns
        behind, before = slice(cell, cell + REACH), slice(cell - REACH, cell)
        later = np.cumsum(gap_mm**2 * self._own[behind] - 2.0 * gap_mm * score[behind])
        earlier = np.cumsum((gap_mm**2 * self._own[before] + 2.0 * gap_mm * score[before])[::-1])
        change = np.concatenate([earlier[::-1], [0.0], later])
        likelihood = np.exp(-0.5 * (change - change.min()) / max(variance, 1e-300))
        away = np.arange(-REACH, REACH + 1) - (int(change.argmin()) - REACH)
        return cell + int(change.argmin()) - REACH, float(likelihood @ away**2 / likelihood.sum())

    def _shapes(self, cell: int) -> FloatArray:
        """Return the factors of the derivative by u_c in each cell for a gap and a kink before a cell, (2, cells)."""
        behind = np.arange(self._u.size) >= cell
        return np.stack([behind, behind * (self._u - self._border[cell]) * self._turn])

    def _best(self, found: Sequence[int]) -> tuple[int, float]:
        """Return the cell where a gap or a kink has the largest power next to those before the cells found, and it."""
        power = self._powers(found)
        place = int(power.argmax())
        return place, float(power[place])

    def _powers(self, found: Sequence[int], least_power: float = math.inf) -> FloatArray:
        """Compute the power of a module before each cell (cells,), 0 where none may begin.

        The power is that of a gap or of a kink, or of both less `least_power`, which the second must explain.
        """
        shapes = np.concatenate([np.empty((0, self._u.size)), *(self._shapes(cell) for cell in found)])
        with_columns = np.concatenate([self._with_columns, shapes * self._own])
        crossed = self._with_columns @ shapes.T
        normal = np.block([[self._normal, crossed], [crossed.T, (shapes * self._own) @ shapes.T]])
        inverse = scaled_inverse(normal)
        score = self._score - (inverse @ np.concatenate([self._of_base, shapes @ self._score])) @ with_columns
        turn, border = self._turn, self._border

        def of_kink(values: FloatArray) -> FloatArray:
            return _behind(values * turn * self._u) - border * _behind(values * turn)

        by_gap, by_kink = _behind(with_columns), of_kink(with_columns)
        gaps, turned = _behind(self._own), self._own * turn**2
        kinks = _behind(turned * self._u**2) - 2.0 * border * _behind(turned * self._u) + border**2 * _behind(turned)
        both = [
            (whole - np.einsum("bm,bc,cm->m", crossed, inverse, crossed), whole)
            for whole, crossed in ((gaps, by_gap), (kinks, by_kink))
        ]
        between = of_kink(self._own) - np.einsum("bm,bc,cm->m", by_gap, inverse, by_kink)
        gap, kink = (np.where(left > LEAST_SEEN * whole[0], left, np.inf) for left, whole in both)
        score_of_gap, score_of_kink = _behind(score), of_kink(score)
        share = between**2 / (gap * kink)
        # The part of the kink that the gap leaves.
        apart = np.isfinite(gap) & np.isfinite(kink) & (share < 1.0 - LEAST_SEEN)
        left_of_kink = np.where(apart, kink * (1.0 - share), np.inf)
        of_both = (score_of_kink - between / gap * score_of_gap) ** 2 / left_of_kink - least_power
        power: FloatArray = np.maximum(score_of_gap**2 / gap + np.maximum(of_both, 0.0), score_of_kink**2 / kink)
        beside = np.minimum(gaps, gaps[0] - gaps)
        power[beside < LEAST_BESIDE * gaps[0]] = 0.0
        power[:FEWEST_CELLS] = power[power.size - FEWEST_CELLS + 1 :] = 0.0
        for cell in (*self._taken, *found):
            power[max(cell - FEWEST_CELLS, 0) : cell + FEWEST_CELLS + 1] = 0.0
        return power


def _behind(values: FloatArray) -> FloatArray:
    """Return the sums over a cell and all cells behind it, along the last axis."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]
