"""The joint fit as one linear mixed model: groups of columns, each with a size that is 0 with odds, else log-uniform.

At the point of the fit the residual is J d + sum_g Z_g b_g + e with b_g ~ N(0, s_g^2 U_g^2), U_g the units of the
group's columns. The marginal likelihood of a size has a closed form in the eigenvalues of what the other columns leave
of the group; the likeliest sizes are fitted, those that are not 0 shrink their columns, and the covariance is averaged
over the sizes that are not the likeliest. What is structured in the residual is weak evidence: a group is judged
against the largest of noise, its scatter from view to view and its share of the structure (`selection.py`).
"""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sawmill_tomography.calibration.covariance import scaled_inverse
from sawmill_tomography.calibration.faults.effects import EFFECTS, OF_WOOD
from sawmill_tomography.calibration.faults.finding import AdjustedFit
from sawmill_tomography.calibration.faults.hidden_motions import HiddenMotions
from sawmill_tomography.calibration.faults.slip import (
    angle_scatter,
    jump_at,
    likeliest_slip,
    places_of_slips,
    slip_at,
)
from sawmill_tomography.calibration.fit import OnStep, ignore_progress
from sawmill_tomography.calibration.joint_fit.fitter import JOINING, MODULE_TRIALS, ROUNDS, JointFitter
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.normal_equations import UNTRUSTED, Column, System, ViewGrams
from sawmill_tomography.calibration.joint_fit.readings import Fitted, first_cells_of, is_module
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, Term, is_kink, is_of_module
from sawmill_tomography.calibration.joint_fit.selection import ON_DETECTOR, STRUCTURES, EffectTester
from sawmill_tomography.calibration.joint_fit.steps import BY_ANGLES, is_small, moved, off_by, stepped
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

# Number of sizes, log-uniform between a group's lowest and highest.
SIZES = 8
# A set of groups is left for another one that is likelier by this (logarithm).
BETTER = 0.1
# At most this number of groups join in one round: what several explain together is only known to first order.
MOST_JOINING = 3
MOST_SLIPS = 3
# Number of draws from the sizes that are not the likeliest.
DRAWS = 2048
# The kink that moves cells about as much as a gap of 1 mm.
KINK_RAD_PER_MM = math.radians(0.7)


@dataclass(frozen=True)
class Prior:
    """What is expected of a group: its odds, and its sizes where it is there, in the units of its columns."""

    low: float
    high: float
    odds: float = 0.1


# Units: shares of the longest path's line integral, of the intensity, of the size or of the density; cells^2; mm^2; mm
# at the phantom's rim; mm on the detector.
PRIORS: dict[Adjustment, Prior] = {
    Adjustment.BEAM_HARDENING: Prior(0.003, 0.5),
    Adjustment.SCATTERED_RADIATION: Prior(0.001, 0.1),
    Adjustment.BLUR: Prior(0.03, 3.0),
    Adjustment.LAG: Prior(0.001, 0.06),
    Adjustment.ROTATION_DURING_EXPOSURE: Prior(0.03, 1.0),
    Adjustment.FLAT_FIELD: Prior(0.001, 0.05),
    Adjustment.DENSITY_GRADIENT: Prior(0.003, 0.15),
    Adjustment.DEFORMATION: Prior(0.0003, 0.01),
    Adjustment.CORNERS: Prior(0.3, 60.0),
    Adjustment.PACE: Prior(0.02, 2.0),
    Adjustment.CREEP: Prior(0.02, 0.6),
    Adjustment.ENCODER: Prior(0.02, 1.0),
    Adjustment.WOBBLE: Prior(0.02, 0.6),
    Adjustment.SLIP: Prior(0.02, 0.6),
    Adjustment.BOW: Prior(0.03, 1.5),
    Adjustment.SURFACE_DENSITY: Prior(0.01, 0.4),
    Adjustment.MODULES: Prior(0.05, 5.0),
}


def unit_of(column: Column, model: ScanModel) -> float:
    """Return the unit of a column: the size at which it does what `PRIORS` has in view."""
    term = column.parts[0][0]
    if is_of_module(term):
        return KINK_RAD_PER_MM if is_kink(term) else 1.0
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
        return cls(
            one,
            np.array([unit_of(column, model) for column in one.columns]),
            np.geomspace(prior.low, prior.high, SIZES),
            math.log(odds / (1.0 - odds)),
            ON_DETECTOR if is_module(one) else STRUCTURES,
        )

    def evidence(self, information: FloatArray, score: FloatArray) -> FloatArray:
        """Return the logarithm of odds times likelihood of each size against 0, from what others leave of the group."""
        values, vectors = np.linalg.eigh(information)
        values, square = np.maximum(values, 0.0), (vectors.T @ score) ** 2
        s = self.sizes[:, None] ** 2
        likelihood = 0.5 * (s * square / (1.0 + s * values) - np.log1p(s * values)).sum(axis=1)
        evidence: FloatArray = self.log_odds - math.log(SIZES) + likelihood
        return evidence


@dataclass(frozen=True, eq=False)
class Posterior:
    """The fitted columns at one point for given sizes of the groups, and what they leave of the other groups."""

    system: System
    zero: FloatArray  # (n,): score where the columns of all groups are 0
    variance: float
    base: list[int]
    sizes: dict[Group, float]  # groups that are fitted

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
        mean: FloatArray = self.covariance @ self.zero[self.used] / self.variance
        return mean

    @cached_property
    def sensitivity(self) -> FloatArray:
        """What the fitted columns take up of each column, (used, n)."""
        sensitivity: FloatArray = self.covariance @ self.system.normal[self.used] / self.variance
        return sensitivity

    @cached_property
    def _left(self) -> tuple[FloatArray, FloatArray]:
        cross = self.system.normal[self.used]
        left = self.system.normal - cross.T @ self.sensitivity
        return left / self.variance, (self.zero - cross.T @ self.mean) / self.variance

    def left(self, group: Group) -> tuple[FloatArray, FloatArray]:
        """Return information and score, in the group's units, that the other fitted columns leave of a group."""
        unit, both = group.unit, np.outer(group.unit, group.unit)
        if group not in self.sizes:
            own = np.array(group.one.places)
            return self._left[0][np.ix_(own, own)] * both, self._left[1][own] * unit
        own = np.array([self.used.index(place) for place in group.one.places])
        whole = np.linalg.pinv(self.covariance[np.ix_(own, own)] / both, rcond=1e-12, hermitian=True)
        information = whole - np.eye(len(own)) / self.sizes[group] ** 2
        return information, whole @ (self.mean[own] / unit)

    def resized(self, group: Group, size: float) -> "Posterior":
        """Return the posterior with another size of a group."""
        sizes = {one: before for one, before in self.sizes.items() if one is not group}
        return replace(self, sizes=sizes | {group: size} if size else sizes)

    def change(self) -> FloatArray:
        """Return the change of all columns from the point, to which groups that are not fitted go back."""
        change = np.zeros(len(self.system.columns))
        change[self.used] = self.mean
        return change


class MixtureFitter(JointFitter):
    """The joint fit by the likeliest sizes of all groups."""

    def __init__(self, prepared: AdjustedFit, without: frozenset[Adjustment]) -> None:
        super().__init__(prepared, without, EFFECTS)
        self.size_of: dict[Fitted, float] = {}
        self.scatter: dict[Fitted, float] = {}
        for one in self.fitted:
            self.size_of[one] = float(PRIORS[one.effect.adjustment].high)

    def widened(self, *, patches: bool = False) -> None:
        """Go on with the effects of wood, or with the densities of its patches too."""
        if not self.of_wood:
            self.waiting += self._of_effects(OF_WOOD)
            self.of_wood = True
        self.of_patches = self.of_patches or patches
        self.rounds = 0

    def round(self) -> bool:
        """Let the likeliest groups join, and take one step; return whether the fit has ended."""
        self.rounds += 1
        grams, free = self._linearised()
        system, tried, used = self._system(grams, free)
        if self._relocated_modules(grams, system, used):
            self._carry_over()
            grams, free = self._linearised()
            system, tried, used = self._system(grams, free)
        further = self._further_modules(grams, system, used)
        if further:
            self.waiting += further
            grams, free = self._linearised()
            system, tried, used = self._system(grams, free)
        before = list(self.fitted)
        posterior, groups = self._chosen(system, tried, len(free))
        change, sizes = posterior.change(), np.zeros(len(system.columns))
        for one in (*before, *tried):
            sizes[one.places] = one.sizes
        change = change - sizes
        self._adopt(posterior, tried)
        dropped = [one for one in before if one not in self.fitted]
        self.unneeded |= first_cells_of(dropped) - self.known_modules
        left = max(system.power - 2.0 * float(change @ system.score) + float(change @ system.normal @ change), 0.0)
        degrees = len(posterior.used) - float(posterior.precision @ np.diag(posterior.covariance))
        self.variance = left / max(system.samples - degrees, 1.0)
        penalised = self._penalised(posterior)
        small = is_small(self.model, penalised, posterior.used, change, self.variance)
        self.model, share = stepped(self.model, *system.with_patches(change), grams, may_rise=BY_ANGLES)
        for one in (*self.fitted, *dropped):
            one.sizes = one.sizes + share * change[one.places]
        self.model = self._with_fitted_modules()
        self.last = penalised, tried, posterior.used, change, [], grams
        self.posterior, self.groups = posterior, groups
        self.converged = off_by(penalised, posterior.used, change) <= 25.0 * self.variance
        same = set(before) == set(self.fitted)
        if share == 0.0:
            return True
        if share < 1.0 or not small or not same:
            return False
        self.converged = self._ends(system, change) and not self._moved_modules(grams, penalised, posterior.used)
        return self.converged

    def _moved_modules(self, grams: ViewGrams, system: System, used: list[int]) -> bool:
        moved_borders = self._moved_borders(grams, system, used)
        self._carry_over()
        return moved_borders

    def _carry_over(self) -> None:
        """Give modules that were moved the sizes of priors that they had."""
        for one in self.fitted:
            if one not in self.size_of:
                self.size_of[one] = math.sqrt(PRIORS[Adjustment.MODULES].low * PRIORS[Adjustment.MODULES].high)

    def _ends(self, system: System, change: FloatArray) -> bool:
        if self.angle_variance == 0.0 and Adjustment.ANGLE_JITTER not in self.without:
            self.angle_variance = angle_scatter(system, change, self.variance)
            if self.angle_variance > 0.0:
                return False
        if self.averaging is None or not self.fitted:
            return True
        return self._settled_averaging()

    def _system(self, grams: ViewGrams, free: list[Column]) -> tuple[System, list[Fitted], list[int]]:
        tried = list(self.waiting)
        base = [*free, *(column for one in self.fitted for column in one.columns)]
        if self.of_patches:
            self.variation = grams.vary_densities(base)
        slips = sum(one.effect.adjustment is Adjustment.SLIP for one in self.fitted)
        view = likeliest_slip(base, *grams.of_columns(base)) if slips < MOST_SLIPS else None
        if view is not None and Adjustment.SLIP not in self.without:
            trials = float(len(grams.scores))
            tried += [Fitted(effect, effect.columns(self.model), trials) for effect in (slip_at(view), jump_at(view))]
        system = grams.system([*base, *(column for one in tried for column in one.columns)])
        first = len(free)
        for one in (*self.fitted, *tried):
            one.places = list(range(first, first := first + len(one.columns)))
        return system, tried, list(range(len(base)))

    def _chosen(self, system: System, tried: Sequence[Fitted], free: int) -> tuple[Posterior, list[Group]]:
        """Return the posterior of the likeliest sizes, from those of the round before: the best change at a time."""
        groups = [Group.of(one, self.model) for one in (*self.fitted, *tried) if not one.declined]
        sizes = np.zeros(len(system.columns))
        for one in (*self.fitted, *tried):
            sizes[one.places] = one.sizes
        everything = [*range(free), *(place for group in groups for place in group.one.places)]
        remaining = system.remaining(everything)
        noise = max(remaining / max(system.samples - len(everything), 1.0), 1e-30)
        self.structured = max(system.structured - (system.power - remaining), UNTRUSTED * system.structured)
        fitted = {group: self.size_of[group.one] for group in groups if group.one in self.size_of}
        posterior = Posterior(system, system.score + system.normal @ sizes, noise, list(range(free)), fitted)
        most = MOST_JOINING if self.rounds <= JOINING else 0
        barred: set[Group] = set()
        for _ in range(30):
            best = None
            for group in groups:
                evidence = self._evidence(posterior, group)
                now = posterior.sizes.get(group, 0.0)
                current = 0.0 if not now else float(np.interp(math.log(now), np.log(group.sizes), evidence))
                place = int(evidence.argmax())
                size, gained = float(group.sizes[place]), float(evidence[place]) - current
                if now and -current > gained:
                    size, gained = 0.0, -current
                if not now and (not most or group in barred):
                    continue
                if gained > (BETTER if best is None else best[0]):
                    best = gained, group, size
            if best is None:
                break
            gained, group, size = best
            if group not in posterior.sizes:
                self.scatter[group.one] = _scatter(posterior, group)
                evidence = self._evidence(posterior, group)
                then = posterior.resized(group, float(group.sizes[int(evidence.argmax())]))
                own = np.array([then.used.index(place) for place in group.one.places])
                if evidence.max() <= BETTER or not group.one.effect.possible(self.model, then.mean[own]):
                    barred.add(group)
                    continue
                posterior, most = then, most - 1
            else:
                posterior = posterior.resized(group, size)
                if not size:
                    barred.add(group)
        return posterior, groups

    def _evidence(self, posterior: Posterior, group: Group) -> FloatArray:
        """Return a group's evidence against the largest of three variances."""
        variance = max(posterior.variance * self.scatter.get(group.one, 1.0), self.structured / group.shares)
        information, score = posterior.left(group)
        tempered = posterior.variance / variance
        return group.evidence(tempered * information, tempered * score)

    def _adopt(self, posterior: Posterior, tried: Sequence[Fitted]) -> None:
        """Take the groups of a posterior as those that are fitted."""
        self.size_of = {group.one: size for group, size in posterior.sizes.items()}
        fitted = [group.one for group in posterior.sizes]
        dropped = [one for one in self.fitted if one not in fitted]
        kept = [one for one in self.fitted if one in fitted]
        joined = [one for one in fitted if one not in kept]
        slips = {one for one in (*joined, *dropped) if one.effect.adjustment is Adjustment.SLIP}
        others = [one for one in tried if one.effect.adjustment is Adjustment.SLIP] if slips else []
        self.fitted = [*kept, *joined]
        waiting = [one for one in dict.fromkeys([*self.waiting, *others, *dropped]) if one not in self.fitted]
        self.waiting = [one for one in waiting if first_cells_of([one]) <= self.known_modules]

    @staticmethod
    def _penalised(posterior: Posterior) -> System:
        """Return the system with the precision of the priors."""
        normal = posterior.system.normal.copy()
        normal[posterior.used, posterior.used] += posterior.precision * posterior.variance
        return replace(posterior.system, normal=normal)

    def _settled_averaging(self) -> bool:
        from sawmill_tomography.calibration.joint_fit.fitter import _with_new_averaging

        self.model, self.averaging = _with_new_averaging(self.model, self.averaging), None
        return False

    def result(self) -> JointFit:
        """Return the end point of the fit, and the mixture of the sizes that are not fitted."""
        system, _, used, change, _, grams = self.last
        return JointFit(
            self._with_fitted_modules(),
            tuple(self.fitted),
            system,
            used,
            change,
            self.variance,
            (),
            None,
            (),
            self.angle_variance,
            self.variation if self.variation is not None and self.variation.likelihood > 20.0 else None,
            tuple(self._hidden_modules(grams, system, used)),
            self._mixture(grams),
            self._arc_radius_mm(grams, system, used),
            converged=self.converged,
            rounds=self.rounds,
        )

    def _mixture(self, grams: ViewGrams) -> HiddenMotions | None:
        """Return what other sizes of one group would change: of a group that is not fitted, or 0 of one that is."""
        posterior, rng = self._with_places(grams), np.random.default_rng(0)
        errors, real = np.zeros((DRAWS, len(posterior.used))), np.zeros(DRAWS, bool)
        for group in self._averaged(posterior):
            evidence, biases, roots = zip(*self._cases(posterior, group), strict=True)
            weights = np.exp(np.array([0.0, *evidence]) - max(0.0, *evidence))
            drawn = np.searchsorted(np.cumsum(weights / weights.sum()), rng.random(DRAWS)) - 1
            for number, (bias, root) in enumerate(zip(biases, roots, strict=True)):
                here = drawn == number
                errors[here] += bias + rng.standard_normal((int(here.sum()), root.shape[1])) @ root.T
                real |= here
        if not real.any():
            return None
        return HiddenMotions(np.full(int(real.sum()), 1.0 / DRAWS), errors[real], np.zeros((int(real.sum()), len(posterior.used), 1)))

    def _with_places(self, grams: ViewGrams) -> Posterior:
        """Return the last posterior next to slips at some views."""
        last, columns = self.posterior, list(self.posterior.system.columns)
        views = places_of_slips(len(grams.scores)) if Adjustment.SLIP not in self.without else []
        self.placed = []
        for view in views:
            for effect in (slip_at(view), jump_at(view)):
                one = Fitted(effect, effect.columns(self.model), float(len(views)))
                one.places = list(range(len(columns), len(columns) + len(one.columns)))
                columns += one.columns
                self.placed.append(Group.of(one, self.model))
        system = grams.system(columns)
        sizes = np.zeros(len(columns))
        sizes[last.used] = last.mean
        sizes[last.base] = 0.0
        here = self.last[3]
        before = sizes.copy()
        before[: len(here)] -= here
        before[last.base] = 0.0
        zero = system.score + system.normal @ before
        return replace(last, system=system, zero=zero)

    def _averaged(self, posterior: Posterior) -> Iterator[Group]:
        fresh = {one for one in self.posterior.sizes}
        for group in self.groups:
            if is_module(group.one) and group not in fresh:
                continue
            if group.one.effect.adjustment is Adjustment.SLIP and group not in fresh:
                continue
            yield group
        yield from self.placed

    def _cases(self, posterior: Posterior, group: Group) -> Iterator[tuple[float, FloatArray, FloatArray]]:
        """Yield evidence, bias and root of the covariance that other sizes of a group add to the fitted columns."""
        evidence = self._evidence(posterior, group)
        information, score = posterior.left(group)
        if group in posterior.sizes:
            current = float(np.interp(math.log(posterior.sizes[group]), np.log(group.sizes), evidence))
            own = np.array([posterior.used.index(place) for place in group.one.places])
            within = posterior.covariance[np.ix_(own, own)]
            bias = -posterior.covariance[:, own] @ np.linalg.pinv(within, hermitian=True) @ posterior.mean[own]
            yield -current, bias, np.zeros((len(bias), 1))
            return
        moves = posterior.sensitivity[:, group.one.places] * group.unit
        values, vectors = np.linalg.eigh(information)
        values, turned, along = np.maximum(values, 0.0), moves @ vectors, vectors.T @ score
        for size, one in zip(group.sizes.tolist(), evidence.tolist(), strict=True):
            shrunk = size**2 / (1.0 + size**2 * values)
            yield one, -turned @ (shrunk * along), turned * np.sqrt(shrunk)


def _scatter(posterior: Posterior, group: Group) -> float:
    """Return how much more than noise a group's score scatters from view to view."""
    system = replace(posterior.system, structured=0.0)
    test = EffectTester(system, posterior.used).tested(group.one.places)
    plain = system.variance([*posterior.used, *group.one.places])
    return max(test.variance / plain, 1.0) if plain > 0.0 else 1.0


def fit_mixture(
    prepared: AdjustedFit, without: Collection[Adjustment] = (), on_step: OnStep = ignore_progress
) -> JointFit:
    """Fit geometry and groups from the plain fit; groups in `without` are left out."""
    fitter = MixtureFitter(prepared, frozenset(without))
    fitter.fit(on_step)
    if fitter.shows(OF_WOOD):
        fitter.widened()
        fitter.fit(on_step)
    if Adjustment.WOOD_DENSITY not in without and fitter.shows_varying_density():
        fitter.widened(patches=True)
        fitter.fit(on_step)
    return fitter.result()
