"""Modules of the detector: a gap or a kink before some cell, which moves all cells on one side of it."""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.covariance import scaled_inverse
from sawmill_tomography.calibration.joint_fit._derivatives_numba import taken_of_modules
from sawmill_tomography.calibration.joint_fit.effects import Effect
from sawmill_tomography.calibration.joint_fit.groups import KINK_RAD_PER_MM
from sawmill_tomography.calibration.joint_fit.normal_equations import SINGULAR, Column, System, ViewGrams
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, gap_term, kink_term
from sawmill_tomography.effect_priors import PRIORS
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.geometry.ray_error import DRAWS
from sawmill_vocabulary import Adjustment, DetectorModule
from sawmill_vocabulary.scan_messages import EffectMessage

# A module has at least this many cells.
FEWEST_CELLS = 8
# Steps of a chord at the outline's edges are not linear in a cell's place: differences of chi-square between places
# are looked at where they are less than this factor as much as to first order, this number of cells away.
NOT_LINEAR, AWAY = 6.0, frozenset({0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89})
# A module that stands in for another may begin this number of cells away from it.
NEAR = 16
# The share of all information about u_c that cells on either side of a border must have.
LEAST_BESIDE = 0.01
# The number of modules that a detector is expected to have in addition to those that the scan shows
# (benchmarks/families.py).
HIDDEN = 2.0


# Gaps and kinks of hidden modules too: every order of magnitude is as likely.
PRIOR = PRIORS[Adjustment.MODULES]


@dataclass(frozen=True, eq=False)
class HiddenModule:
    """A module that a scan may hide, or that may begin elsewhere than where the fit found it."""

    first_cell: int
    gap_mm: float  # gap and kink for a factor of 1
    kink_rad: float
    bias: FloatArray  # (used,): errors of the fitted columns in this case, for a factor of 1
    factors: FloatArray  # (n,): factors by which gap, kink and bias may be larger, and the probability of each
    probabilities: FloatArray  # (n,)


class ModulePlaces:
    """Places at which a found module may begin: for each cell the best model, with the power of its residual."""

    def __init__(self) -> None:
        self._at: dict[int, tuple[HiddenModule, ScanModel, float]] = {}

    def __bool__(self) -> bool:
        return bool(self._at)

    def add(self, module: HiddenModule, model: ScanModel, power: float) -> None:
        """Add a place, unless the same cell has a better one."""
        cell = module.first_cell
        if cell not in self._at or power < self._at[cell][2]:
            self._at[cell] = module, model, power

    @property
    def best(self) -> tuple[HiddenModule, ScanModel, float]:
        """The place with the least power."""
        return min(self._at.values(), key=lambda place: place[2])

    def likely(self, variance: float) -> tuple[HiddenModule, ...]:
        """Return the places with their probabilities, for a residual of this variance; each stands for its cells."""
        cells = sorted(self._at)
        powers = np.array([self._at[cell][2] for cell in cells])
        count = np.gradient(np.array(cells, np.float64)) if len(cells) > 1 else np.ones(1)
        likelihood = count * np.exp((powers.min() - powers) / (2.0 * variance))
        likelihood /= likelihood.sum()
        return tuple(
            replace(self._at[cell][0], probabilities=np.array([each]))
            for cell, each in zip(cells, likelihood.tolist(), strict=True)
            if DRAWS * each > 1.0
        )


def effect_of(module: DetectorModule) -> Effect:
    """Return the effect of a module's gap and kink, which start from the given ones."""
    return Effect(
        Adjustment.MODULES,
        lambda _: (Column.of(gap_term(module.first_cell)), Column.of(kink_term(module.first_cell))),
        lambda _, sizes: EffectMessage.MODULE(
            cell=module.first_cell,
            gap_mm=module.gap_mm + float(sizes[0]),
            angle_deg=math.degrees(module.kink_rad + sizes[1]),
        ),
        # A scan that is far from its model for other reasons would show larger ones than any detector has.
        possible=lambda _, sizes: abs(sizes[0]) <= PRIOR.high and abs(sizes[1]) <= PRIOR.high * KINK_RAD_PER_MM,
    )


def with_modules(model: ScanModel, modules: Iterable[DetectorModule]) -> ScanModel:
    """Return the model with these modules only."""
    ordered = tuple(sorted(modules, key=lambda one: one.first_cell))
    if ordered == model.data.cells.modules:
        return model
    return replace(model, data=replace(model.data, cells=replace(model.data.cells, modules=ordered)))


class ModuleSearch:
    """The power that a gap or a kink before each cell explains next to the columns of a fit.

    Cells near the borders of known modules, and of modules that were not needed (`avoided`), are left out.
    """

    # A hidden module has a gap, mm, a kink, rad, or both, which hide each other in few views (test_modules.py).
    MOVES = ((1.0, 0.0), (0.0, KINK_RAD_PER_MM), (1.0, KINK_RAD_PER_MM), (1.0, -KINK_RAD_PER_MM))

    def __init__(
        self, model: ScanModel, grams: ViewGrams, system: System, used: list[int], avoided: Collection[int]
    ) -> None:
        self._terms = [system.columns[place].term for place in used]
        self._products = grams.by_cell([system.columns[place] for place in used])
        self._normal, self._of_base = system.normal[np.ix_(used, used)], system.score[used]
        cells, (self._u, self._turn) = model.data.cells, model.by_kink
        self._taken = [*avoided, *(module.first_cell for module in cells.modules)]
        self._border = cells.first_border_mm + cells.width_mm * np.arange(cells.count)
        self._found: dict[int, tuple[FloatArray, FloatArray, FloatArray]] = {}

    def likeliest(self, least_power: float, most: int) -> list[int]:
        """Find the cells before which a gap or a kink explains more than this power.

        The cells are found one after another, each next to the ones before; then each again next to the others. A gap
        and a kink together would replace the modules that are not found yet.
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
        for name in ("_of_columns", "_of_score"):
            rest.__dict__.pop(name, None)
        kept = [n for n, term in enumerate(self._terms) if term not in {gap_term(cell), kink_term(cell)}]
        shape = np.array([-module.gap_mm, module.kink_rad]) @ self._shapes(cell)
        products = self._products
        rest._products = replace(  # noqa: SLF001
            products,
            with_columns=products.with_columns[kept],
            score=products.score + products.of_shapes(shape[None])[0],
        )
        rest._terms = [self._terms[n] for n in kept]  # noqa: SLF001
        rest._normal = self._normal[np.ix_(kept, kept)]  # noqa: SLF001
        rest._of_base = (self._of_base + products.with_columns @ shape)[kept]  # noqa: SLF001
        rest._taken = [taken for taken in self._taken if taken != cell]  # noqa: SLF001
        return rest

    def hidden(self, variance: float) -> Iterator[HiddenModule]:
        """Yield modules that the residual of this variance may hide, where `HIDDEN` of them are likely beforehand.

        The residual hides at most one. Each place, each of `MOVES` and each order of magnitude is as likely. Of
        neighbouring cells the likeliest one is taken for all.
        """
        left, factors = self._left(), np.concatenate([-PRIOR.sizes, PRIOR.sizes])
        exponents = np.full((len(self.MOVES), factors.size, left.seen.size), -np.inf)
        for exponent, move in zip(exponents, self.MOVES, strict=True):
            information, score = left.of(*move)
            known, factor = left.seen & np.isfinite(information), factors[:, None]
            exponent[:, known] = (factor * score[known] - 0.5 * factor**2 * information[known]) / variance
        most = max(float(exponents.max()), 0.0)
        ratios = np.exp(exponents - most) * HIDDEN / (len(self.MOVES) * factors.size * max(int(left.seen.sum()), 1))
        probabilities = ratios / (math.exp(-most) + ratios.sum())
        for first in range(0, left.seen.size, NEAR):
            some = probabilities[..., first : first + NEAR]
            cell = first + int(some.sum(axis=(0, 1)).argmax())
            for (gap_mm, kink_rad), each in zip(self.MOVES, some.sum(axis=2), strict=True):
                kept = DRAWS * factors.size * each > 1.0
                if kept.any():
                    bias = gap_mm * left.moved_by[0][:, cell] - kink_rad * left.moved_by[1][:, cell]
                    yield HiddenModule(cell, gap_mm, kink_rad, bias, factors[kept], each[kept])

    def elsewhere(self, module: DetectorModule, variance: float) -> Iterator[HiddenModule]:
        """Yield the places at which a module among the columns may begin as well, by their likelihood."""
        sizes = {gap_term(module.first_cell): module.gap_mm, kink_term(module.first_cell): module.kink_rad}
        own = [self._terms.index(term) for term in sizes]
        others = [n for n in range(len(self._terms)) if n not in own]
        left = self._without(module)._left()  # noqa: SLF001 - its own class
        gap, kink, power = left.best()
        possible = (np.abs(gap) <= PRIOR.high) & (np.abs(kink) <= PRIOR.high * KINK_RAD_PER_MM)
        likelihood, able = np.zeros(power.size), np.flatnonzero(left.seen & possible)
        likelihood[able] = np.exp((power[able] - power[able].max(initial=0.0)) / (2.0 * variance))
        likelihood /= max(likelihood.sum(), 1.0)
        known = np.array(list(sizes.values()))
        removed = np.zeros(len(self._terms))
        removed[own] = -known
        removed[others] = (
            scaled_inverse(self._normal[np.ix_(others, others)]) @ self._normal[np.ix_(others, own)] @ known
        )
        for cell in np.flatnonzero(DRAWS * likelihood > 1.0):
            bias = removed.copy()
            bias[others] -= gap[cell] * left.moved_by[0][:, cell] + kink[cell] * left.moved_by[1][:, cell]
            yield HiddenModule(int(cell), -gap[cell], kink[cell], bias, np.ones(1), likelihood[cell : cell + 1])

    def left_of(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return information and score that the base's columns leave of factors (n, cells) of the derivative by u_c."""
        with_columns = rows @ self._products.with_columns.T
        moved = scaled_inverse(self._normal) @ with_columns.T
        information = self._products.of_shapes(rows) @ rows.T - with_columns @ moved
        return information, rows @ self._products.score - self._of_base @ moved

    def places(self, module: DetectorModule, variance: float) -> Iterator[HiddenModule]:
        """Yield places at which a module among the columns may begin: near it, and where it explains much as well.

        What a place explains is known to first order only, by `NOT_LINEAR` in the variance. Places at which both sides
        of the border stay where they are follow.
        """
        for one in self.elsewhere(module, NOT_LINEAR * variance):
            if abs(one.first_cell - module.first_cell) in AWAY:
                yield one
        cell, bias, near = module.first_cell, np.zeros(len(self._terms)), FEWEST_CELLS // 2
        bias[[self._terms.index(term(cell)) for term in (gap_term, kink_term)]] = -module.gap_mm, -module.kink_rad
        for other in range(max(cell - near, 1), min(cell + near + 1, self._u.size)):
            gap_mm = module.gap_mm - module.kink_rad * (self._border[other] - self._border[cell]) * self._turn[cell]
            yield HiddenModule(other, float(gap_mm), module.kink_rad, bias, np.ones(1), np.ones(1))

    def _shapes(self, cell: int) -> FloatArray:
        """Return the factors of the derivative by u_c in each cell for a gap and a kink before a cell, (2, cells)."""
        side = (np.arange(self._u.size) >= cell) - float(cell <= self._u.size // 2)
        return np.stack([side, side * (self._u - self._border[cell]) * self._turn])

    def _best(self, found: Sequence[int]) -> tuple[int, float]:
        """Return the cell where a gap or a kink has the largest power next to those before the cells found, and it."""
        power = self._powers(found)
        place = int(power.argmax())
        return place, float(power[place])

    def _powers(self, found: Sequence[int], least_power: float = math.inf) -> FloatArray:
        """Compute the power (cells,) of a module before each cell: of a gap, a kink, or both less `least_power`."""
        left = self._left(found)
        score_of_gap, score_of_kink = left.scores
        of_both = left.score_of_kink_alone**2 / left.of_kink_alone - least_power
        power: FloatArray = np.maximum(
            score_of_gap**2 / left.gap + np.maximum(of_both, 0.0), score_of_kink**2 / left.kink
        )
        power[~left.seen] = 0.0
        for cell in (*self._taken, *found):
            power[max(cell - FEWEST_CELLS, 0) : cell + FEWEST_CELLS + 1] = 0.0
        return power

    def _left(self, found: Sequence[int] = ()) -> "_Left":
        """Compute what the base's columns, and gaps and kinks before the cells found, leave of a module."""
        products = self._products
        shapes = np.concatenate([np.empty((0, self._u.size)), *(self._shapes(cell) for cell in found)])
        own, *moved = zip(*(self._beside(cell) for cell in found), strict=True) if found else ((), (), ())
        crossed = products.with_columns @ shapes.T
        normal = self._normal
        if found:
            normal = np.block([[normal, crossed], [crossed.T, np.concatenate(own) @ shapes.T]])
        inverse = scaled_inverse(normal)
        change = inverse @ np.concatenate([self._of_base, shapes @ products.score])
        by_gap, by_kink = (np.concatenate([base, *some]) for base, some in zip(self._of_columns, moved, strict=True))
        moved_by = inverse @ by_gap, inverse @ by_kink
        of_gap, of_kink = self._of_score
        gaps, kinks, between, seen = self._alone
        gap, kink = (
            np.where(left > SINGULAR * whole[0], left, np.inf)
            for left, whole in (
                (gaps - (by_gap * moved_by[0]).sum(axis=0), gaps),
                (kinks - (by_kink * moved_by[1]).sum(axis=0), kinks),
            )
        )
        between = between - (by_gap * moved_by[1]).sum(axis=0)
        return _Left(gap, kink, between, (of_gap - change @ by_gap, of_kink - change @ by_kink), moved_by, seen)

    def _both(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return sums over the cells that a gap moves, and over those that a kink moves, before each cell."""
        return _moved(values), self._of_kink(values)

    @cached_property
    def _of_columns(self) -> tuple[FloatArray, FloatArray]:
        return self._both(self._products.with_columns)

    @cached_property
    def _of_score(self) -> tuple[FloatArray, FloatArray]:
        return self._both(self._products.score)

    def _beside(self, cell: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the products with a gap and a kink before a cell (2, cells), and their sums as `_both` does."""
        if cell not in self._found:
            of_shapes = self._products.of_shapes(self._shapes(cell))
            self._found[cell] = of_shapes, *self._both(of_shapes)
        return self._found[cell]

    @cached_property
    def _alone(self) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
        """Information about a gap, a kink and between both without other columns, and where a module may begin."""
        products, own = self._products, self._products.own
        of_gap, of_kink, of_both = taken_of_modules(
            products.taken, products.by_stripes, self._u, self._turn, self._border
        )
        turned, side = own * self._turn**2, np.where(np.arange(own.size) > own.size // 2, 1.0, -1.0)
        gaps = side * _moved(own) - of_gap
        border = self._border
        kinks = _moved(turned * self._u**2) - 2.0 * border * _moved(turned * self._u) + border**2 * _moved(turned)
        kinks = side * kinks - of_kink
        before = np.cumsum(own) - own
        seen = np.minimum(before, own.sum() - before) >= LEAST_BESIDE * own.sum()
        seen[:FEWEST_CELLS] = seen[seen.size - FEWEST_CELLS + 1 :] = False
        return gaps, kinks, side * self._of_kink(own) - of_both, seen

    def _of_kink(self, values: FloatArray) -> FloatArray:
        """Return the sums as `_moved` does, each cell's value times its movement by a kink."""
        return np.asarray(_moved(values * self._turn * self._u) - self._border * _moved(values * self._turn))


@dataclass(frozen=True, eq=False)
class _Left:
    """What other columns leave of a gap and a kink before each cell."""

    gap: FloatArray  # (cells,): information about a gap, about a kink, and between both
    kink: FloatArray  # (cells,)
    between: FloatArray  # (cells,)
    scores: tuple[FloatArray, FloatArray]  # two (cells,): scores of a gap and of a kink
    moved_by: tuple[FloatArray, FloatArray]  # two (columns, cells)
    seen: NDArray[np.bool_]  # (cells,) bool: cells before which a module may begin

    def of(self, gap_mm: float, kink_rad: float) -> tuple[FloatArray, FloatArray]:
        """Return information (cells,), infinite where there is none, and score (cells,) of a gap with a kink."""
        # A gap moves the rays' places on the cells the other way.
        information = -2.0 * gap_mm * kink_rad * self.between
        for size, own in ((gap_mm, self.gap), (kink_rad, self.kink)):
            information += size * size * own if size else 0.0
        return np.maximum(information, 0.0), kink_rad * self.scores[1] - gap_mm * self.scores[0]

    def best(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the likeliest gap and kink before each cell, and the power that they explain."""
        of_gap, alone = self.scores[0], self.score_of_kink_alone
        kink = alone / self.of_kink_alone
        return (of_gap - self.between * kink) / self.gap, kink, of_gap**2 / self.gap + alone * kink

    @property
    def score_of_kink_alone(self) -> FloatArray:
        """Score (cells,) of the part of a kink that the gap leaves."""
        of_gap, of_kink = self.scores
        return np.asarray(of_kink - self.between / self.gap * of_gap)

    @property
    def of_kink_alone(self) -> FloatArray:
        """Information (cells,) about a kink that the gap leaves; infinite where both are alike."""
        share = self.between**2 / (self.gap * self.kink)
        apart = np.isfinite(self.gap) & np.isfinite(self.kink) & (share < 1.0 - SINGULAR)
        return np.asarray(np.where(apart, self.kink * (1.0 - share), np.inf))


def _moved(values: FloatArray) -> FloatArray:
    """Return sums, along the last axis, over the cells that a module moves: those behind, or minus those before."""
    sums = np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]
    sums[..., : values.shape[-1] // 2 + 1] -= sums[..., :1].copy()
    return sums
