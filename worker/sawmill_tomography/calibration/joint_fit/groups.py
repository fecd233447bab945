"""Groups of columns that a scan may show, each declared with its prior, and their posterior at one point of the fit.

At the point of the fit the residual is J d + sum of Z_g b_g + e with b_g ~ N(0, s_g^2 U_g^2), U_g the units of the
group's columns, and s_g 0 with odds, else log-uniform. The marginal likelihood of a size has a closed form in the
eigenvalues of what the other columns leave of the group (docs/understand/verdict.md).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.covariance import pseudo_inverse, scaled_inverse, unit_scale
from sawmill_tomography.calibration.joint_fit._derivatives_numba import evidences
from sawmill_tomography.calibration.joint_fit.effects import UNSTEADY_MOTIONS, WAVES, Effect
from sawmill_tomography.calibration.joint_fit.normal_equations import Column, System
from sawmill_tomography.calibration.joint_fit.scan_model import (
    ScanModel,
    Term,
    arc_term,
    is_kink,
    is_of_detector,
    is_of_module,
    number_of,
)
from sawmill_tomography.effect_priors import PRIORS, SIZES
from sawmill_tomography.geometry.detector_shape import FIRST_WAVE
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

# Effects that move the phantom or the angles.
MOTIONS = frozenset({Adjustment.PACE, Adjustment.CREEP, Adjustment.SLIP, Adjustment.ENCODER, Adjustment.WOBBLE})
# The kink that moves cells about as much as a gap of 1 mm.
KINK_RAD_PER_MM = math.radians(0.7)
# Number of independent errors that a drawing, or the wood, may have: every effect explains one such share of the
# structured residual by chance (tests/test_measured.py). The second number is for an effect that stays in place on the
# detector, while the drawing and the wood turn.
STRUCTURES, ON_DETECTOR = 100.0, 400.0


@dataclass(eq=False)
class Fitted:
    """An effect that is fitted, or may be."""

    effect: Effect
    columns: tuple[Column, ...]
    trials: float = 1.0  # number of places at which the effect may be: the views, for a slip
    view: int | None = None  # the view at which a slip or a jump is
    declined: bool = False  # the effect must not join the fit: it was not possible, or the user switched it off
    sizes: FloatArray = field(init=False)  # (columns,): sizes of the effect's columns
    places: list[int] = field(init=False, default_factory=list)  # indices of the effect's columns in the current system

    def __post_init__(self) -> None:
        """Set all sizes to 0."""
        self.sizes = np.zeros(len(self.columns))


def is_module(one: Fitted) -> bool:
    """Return whether an effect is the gap and kink of a module."""
    return one.effect.adjustment is Adjustment.MODULES


def is_on_detector(one: Fitted) -> bool:
    """Return whether an effect stays in place on the detector: cells elsewhere than the plain model has them."""
    return one.effect.adjustment in (Adjustment.MODULES, Adjustment.CELL_PLACES)


def is_motion(one: Fitted) -> bool:
    """Return whether an effect moves the phantom or the angles."""
    return one.effect.adjustment in MOTIONS


def first_cells_of(effects: Sequence[Fitted]) -> set[int]:
    """Return the first cells of the modules whose gaps and kinks are among the effects."""
    terms = [column.term for one in effects for column in one.columns]
    return {number_of(term) for term in terms if term is not None and is_of_module(term)}


def unit_of(column: Column, model: ScanModel) -> float:
    """Return the unit of a column: the size at which it does what `PRIORS` has in view."""
    term = column.parts[0][0]
    if is_of_module(term):
        return KINK_RAD_PER_MM if is_kink(term) else 1.0
    if term == arc_term():
        # The curvature that moves the ray of an end of the detector by 10 mm.
        return 10.0 / max(float(np.abs(model.rows_of_cells([arc_term()])).max()), 1e-9)
    if is_of_detector(term):
        return FIRST_WAVE / (FIRST_WAVE + number_of(term))
    if term in (Term.PSI, Term.GRADIENT_X, Term.GRADIENT_Y):
        return 1.0 / model.drawing.radius_mm
    if term in (Term.HARDENING, Term.HARDENING_CUBIC):
        longest = max(float(model.lengths.max()), 1e-9)
        return 1.0 / longest if term is Term.HARDENING else 1.0 / longest**2
    return 1.0


@dataclass(frozen=True, eq=False)
class Group:
    """Columns with one size."""

    one: Fitted
    unit: FloatArray  # (columns,)
    sizes: FloatArray  # (SIZES,)
    log_odds: float  # of any size against 0, for one place
    shares: float  # number of shares of the structure of which the group explains one by chance

    @classmethod
    def of(cls, one: Fitted, model: ScanModel) -> "Group":
        """Return the group of an effect."""
        prior = PRIORS[one.effect.adjustment]
        odds = prior.odds / max(one.trials, 1.0)
        unit = np.array([unit_of(column, model) for column in one.columns])
        # A jump that was found before the fit may be larger than any that the fit finds.
        largest = float(np.abs(one.sizes / unit).max())
        return cls(
            one,
            unit,
            (prior if largest <= prior.high else replace(prior, high=largest)).sizes,
            math.log(odds / (1.0 - odds)),
            # What is wrong with a drawing turns with it, as slow waves do.
            ON_DETECTOR if is_on_detector(one) else STRUCTURES / (WAVES if one.effect in UNSTEADY_MOTIONS else 1),
        )

    def at(self, evidence: FloatArray, size: float) -> float:
        """Return the evidence of a size between two of the sizes."""
        return float(np.interp(math.log(size), np.log(self.sizes), evidence))

    def evidence(self, information: FloatArray, score: FloatArray) -> FloatArray:
        """Return the logarithm of odds times likelihood of each size against 0, from what others leave of the group."""
        width = len(score)
        begins, one = np.array([0, width]), np.ones(width)
        likelihood = evidences(information, score, begins, np.arange(width), one, one[:1], self.sizes[None])[0]
        return np.asarray(self.log_odds - math.log(SIZES) + likelihood)


@dataclass(frozen=True, eq=False)
class GroupColumns:
    """The columns of groups (g), one after another (c)."""

    begins: NDArray[np.intp]  # (g + 1,): where the columns of each group begin
    places: NDArray[np.intp]  # (c,)
    unit: FloatArray  # (c,)
    sizes: FloatArray  # (g, SIZES)
    log_odds: FloatArray  # (g,): of any size
    shares: FloatArray  # (g,)

    @classmethod
    def of(cls, groups: Sequence[Group]) -> "GroupColumns":
        """Return the columns of groups."""
        return cls(
            np.cumsum([0, *(len(group.unit) for group in groups)]),
            np.array([place for group in groups for place in group.one.places], np.intp),
            np.concatenate([np.empty(0), *(group.unit for group in groups)]),
            np.array([group.sizes for group in groups]).reshape(-1, SIZES),
            np.array([group.log_odds for group in groups]),
            np.array([group.shares for group in groups]),
        )

    def evidences(self, information: FloatArray, score: FloatArray, tempered: FloatArray) -> FloatArray:
        """Return the evidence (g, SIZES) of the groups, as `Group.evidence` does.

        The information (n, n) and the score (n,) are for all columns; each group's count by `tempered` (g,).
        """
        likelihood = evidences(information, score, self.begins, self.places, self.unit, tempered, self.sizes)
        return np.asarray(self.log_odds[:, None] - math.log(SIZES) + likelihood)


@dataclass(frozen=True, eq=False)
class Posterior:
    """The fitted columns at one point for given sizes of the groups, and what they leave of the other groups."""

    system: System
    zero: FloatArray  # (n,): score where the columns of all groups are 0
    variance: float
    base: list[int]
    sizes: dict[Group, float]  # groups that are fitted
    # How much more than noise the scores of groups scatter from view to view, next to these, where that is known.
    scatter: dict[Group, float] = field(default_factory=dict)

    @cached_property
    def used(self) -> list[int]:
        """Indices of the fitted columns."""
        return [*self.base, *(place for group in self.sizes for place in group.one.places)]

    @cached_property
    def precision(self) -> FloatArray:
        """Precision (used,) that the priors give."""
        own = [1.0 / (size * group.unit) ** 2 for group, size in self.sizes.items()]
        return np.concatenate([np.zeros(len(self.base)), *own])

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance (used, used)."""
        normal = self.system.normal[np.ix_(self.used, self.used)] / self.variance
        return scaled_inverse(normal + np.diag(self.precision))

    @cached_property
    def mean(self) -> FloatArray:
        """Sizes (used,) of groups' columns, and changes of the base's."""
        return np.asarray(self.covariance @ self.zero[self.used] / self.variance)

    @cached_property
    def sensitivity(self) -> FloatArray:
        """What the fitted columns take up of each column, (used, n)."""
        return np.asarray(self.covariance @ self.system.normal[self.used] / self.variance)

    @cached_property
    def left_of_all(self) -> tuple[FloatArray, FloatArray]:
        """Information and score that the fitted columns leave of all columns."""
        cross = self.system.normal[self.used]
        left = self.system.normal - cross.T @ self.sensitivity
        return left / self.variance, (self.zero - cross.T @ self.mean) / self.variance

    def left(self, group: Group) -> tuple[FloatArray, FloatArray]:
        """Return information and score, in the group's units, that the other fitted columns leave of a group."""
        unit, both = group.unit, np.outer(group.unit, group.unit)
        if group not in self.sizes:
            own = np.array(group.one.places)
            return self.left_of_all[0][np.ix_(own, own)] * both, self.left_of_all[1][own] * unit
        own = np.array([self.used.index(place) for place in group.one.places])
        whole = pseudo_inverse(self.covariance[np.ix_(own, own)] / both, 1e-12)
        return whole - np.eye(len(own)) / self.sizes[group] ** 2, whole @ (self.mean[own] / unit)

    @cached_property
    def log_likelihood(self) -> float:
        """Logarithm of prior times marginal likelihood of the sizes, against that of another set of groups."""
        normal = self.system.normal[np.ix_(self.used, self.used)] / self.variance
        scale = unit_scale(normal)
        both = normal * np.outer(scale, scale) + np.diag(self.precision * scale**2)
        _, log_determinant = np.linalg.slogdet(both + 1e-12 * np.eye(len(both)))
        own = np.log(self.precision[len(self.base) :]) + 2.0 * np.log(scale[len(self.base) :])
        prior = sum(group.log_odds - math.log(SIZES) for group in self.sizes)
        explained = float(self.zero[self.used] @ self.mean) / self.variance
        return 0.5 * (explained - float(log_determinant) + float(own.sum())) + prior

    @property
    def penalised(self) -> System:
        """The system with the precision that the priors give."""
        normal = self.system.normal.copy()
        normal[self.used, self.used] += self.precision * self.variance
        return replace(self.system, normal=normal)

    def resized(self, group: Group, size: float) -> "Posterior":
        """Return the posterior with another size of a group."""
        sizes = {one: before for one, before in self.sizes.items() if one is not group}
        return replace(self, sizes=sizes | {group: size} if size else sizes, scatter=dict(self.scatter))

    def without(self, out: Callable[[Fitted], bool]) -> "Posterior":
        """Return the posterior without the groups of some effects."""
        sizes = {group: size for group, size in self.sizes.items() if not out(group.one)}
        return replace(self, sizes=sizes, scatter=dict(self.scatter))

    def change(self) -> FloatArray:
        """Return the change of all columns from the point, to which groups that are not fitted go back."""
        change = np.zeros(len(self.system.columns))
        change[self.used] = self.mean
        return change
