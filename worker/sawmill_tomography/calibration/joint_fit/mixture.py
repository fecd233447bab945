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

from sawmill_tomography.calibration.covariance import scaled_inverse, unit_scale
from sawmill_tomography.calibration.faults.effects import EFFECTS, OF_WOOD, Effect, in_the_laboratory, of_position, progress
from sawmill_tomography.calibration.faults.finding import AdjustedFit
from sawmill_tomography.calibration.faults.hidden_motions import HiddenMotions
from sawmill_tomography.calibration.faults.modules import with_modules
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
from sawmill_tomography.calibration.joint_fit.readings import MOTIONS, Fitted, first_cells_of, is_module
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, Term, is_kink, is_of_module
from sawmill_tomography.calibration.joint_fit.selection import ON_DETECTOR, STRUCTURES, EffectTester
from sawmill_tomography.calibration.joint_fit.steps import BY_ANGLES, is_small, moved, off_by, stepped
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment, DetectorModule
from sawmill_vocabulary.scan_messages import EffectMessage

# Number of sizes, log-uniform between a group's lowest and highest.
SIZES = 8
# A set of groups is left for another one that is likelier by this (logarithm).
BETTER = 0.1
# At most this number of groups join in one round: what several explain together is only known to first order.
MOST_JOINING = 3
MOST_SLIPS = 3
# A set of motions has at most this number of groups that join at once; this number of sets is left by one group each,
# and the fit goes over to another set at most OTHER_SETS times.
MOST_MOTIONS, LEFT, OTHER_SETS = 6, 3, 3
# Motions are looked at where the evidence of one is larger than this (logarithm).
SUSPECTED = -2.0
# Sets of motions with a smaller probability are left out.
LEAST_PROBABILITY = 1e-3
# A slip may be this number of views away from where it was found.
NEAR_VIEWS = (-3, -2, -1, 1, 2, 3)
# Motions of which one kind is looked at first, and their numbers of columns: slips of the phantom, jumps of the scanner,
# motions that go on from the first view to the last, and motions that turn with the table.
STARTS = (
    ({Adjustment.SLIP}, {3}),
    ({Adjustment.SLIP}, {2}),
    ({Adjustment.CREEP, Adjustment.PACE}, {1, 2}),
    ({Adjustment.WOBBLE, Adjustment.ENCODER}, {4}),
)
# A climb ends after this number of changes.
CHANGES = 30
# In fewer views modules are only hidden ones: what few views leave looks like one.
FEWEST_VIEWS = 12
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
    Adjustment.MODULES: Prior(0.05, 5.0, odds=0.01),
}


# Times, as shares of the scan, in which phantom or scanner come to rest.
REST = (0.1, 0.2, 0.4)


def _coming_to_rest(time: float) -> tuple[Effect, Effect]:
    """Return the effects of a phantom, and of a scanner, that come to rest in this share of the scan."""

    def shape(model: ScanModel) -> FloatArray:
        gone = np.exp(-(progress(model) + 0.5) / time)
        return gone - gone.mean()

    return (
        Effect(
            Adjustment.CREEP,
            lambda model: of_position([shape(model)]),
            lambda _, sizes: EffectMessage.PHANTOM_CREEP(creep_mm=math.hypot(*sizes)),
        ),
        Effect(
            Adjustment.CREEP,
            lambda model: in_the_laboratory(model, [shape(model)]),
            lambda _, sizes: EffectMessage.SCANNER_CREEP(scanner_creep_mm=math.hypot(*sizes)),
        ),
    )


RESTING = tuple(effect for time in REST for effect in _coming_to_rest(time))


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

    def at(self, evidence: FloatArray, size: float) -> float:
        """Return the evidence of a size between two of the sizes."""
        return float(np.interp(math.log(size), np.log(self.sizes), evidence))

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
        whole = np.linalg.pinv(self.covariance[np.ix_(own, own)] / both, rcond=1e-12, hermitian=True)
        information = whole - np.eye(len(own)) / self.sizes[group] ** 2
        return information, whole @ (self.mean[own] / unit)

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

    def __init__(self, prepared: AdjustedFit, without: frozenset[Adjustment], *, of_sets: bool) -> None:
        super().__init__(prepared, without, EFFECTS)
        for one in self._of_effects(RESTING):
            one.trials = float(len(REST))
            self.waiting.append(one)
        self.of_sets, self.views = of_sets, len(prepared.data.sinogram)
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
        for one in {*before, *tried}:
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

    def _further_modules(self, grams: ViewGrams, system: System, used: list[int]) -> list[Fitted]:
        return super()._further_modules(grams, system, used) if self.views >= FEWEST_VIEWS else []

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
        impossible = [one for one in self.fitted if not one.effect.possible(self.model, one.sizes)]
        for one in impossible:
            self.model = moved(self.model, one.columns, -one.sizes)
            self.fitted.remove(one)
            self.size_of.pop(one)
            if not is_module(one):
                self.waiting.append(Fitted(one.effect, one.columns, one.trials, declined=True))
        self.unneeded |= first_cells_of(impossible)
        self.model = self._with_fitted_modules()
        if impossible:
            return False
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
        best = self._climbed(posterior, groups, most)
        modules = [group for group in groups if is_module(group.one)]
        if most and self.of_sets and any(group not in best.sizes for group in modules):
            still = posterior
            for group in [one for one in posterior.sizes if one.one.effect.adjustment in MOTIONS]:
                still = still.resized(group, 0.0)
            other = self._climbed(still, modules, len(modules))
            other = self._climbed(other, groups, most) if set(other.sizes) != set(still.sizes) else other
            if self._tempered(other).log_likelihood > self._tempered(best).log_likelihood + BETTER:
                best = other
        return best, groups

    def _climbed(
        self, posterior: Posterior, groups: Sequence[Group], most: int, barred: Collection[Group] = ()
    ) -> Posterior:
        """Return the posterior after the best changes of one size at a time; at most `most` groups join."""
        out = set(barred)
        for _ in range(CHANGES):
            left = [group for group in groups if group not in posterior.sizes and group not in out] if most else []
            changes = [(0.0, None, 0.0)]
            for group, evidence in zip(left, self._evidences(posterior, left), strict=True):
                place = int(evidence.argmax())
                changes.append((float(evidence[place]), group, float(group.sizes[place])))
            for group, now in posterior.sizes.items():
                evidence = self._evidence(posterior, group)
                current, place = group.at(evidence, now), int(evidence.argmax())
                changes.append((float(evidence[place]) - current, group, float(group.sizes[place])))
                changes.append((-current, group, 0.0))
            gained, group, size = max(changes, key=lambda change: change[0])
            if group is None or gained <= BETTER:
                break
            if group in posterior.sizes:
                posterior = posterior.resized(group, size)
                if not size:
                    out.add(group)
                continue
            self.scatter[group.one] = _scatter(posterior, group)
            evidence = self._evidence(posterior, group)
            then = posterior.resized(group, float(group.sizes[int(evidence.argmax())]))
            own = [then.used.index(place) for place in group.one.places]
            # The gap and kink of one of several modules are often not possible before the others have joined.
            may = is_module(group.one) or group.one.effect.possible(self.model, then.mean[own])
            if evidence.max() > BETTER and may:
                posterior, most = then, most - 1
            else:
                out.add(group)
        return posterior

    def _evidences(self, posterior: Posterior, groups: Sequence[Group]) -> list[FloatArray]:
        """Return the evidence of groups that are not fitted, as `_evidence` does."""
        found: dict[Group, FloatArray] = {}
        for width in {len(group.unit) for group in groups}:
            alike = [group for group in groups if len(group.unit) == width]
            places, units = np.array([group.one.places for group in alike]), np.stack([each.unit for each in alike])
            scatter = np.array([self.scatter.get(group.one, 1.0) for group in alike])
            shares = np.array([group.shares for group in alike])
            tempered = posterior.variance / np.maximum(posterior.variance * scatter, self.structured / shares)
            information, score = posterior.left_of_all
            values, vectors = np.linalg.eigh(
                information[places[:, :, None], places[:, None]] * units[:, :, None] * units[:, None]
            )
            square = ((score[places] * units)[:, None] @ vectors)[:, 0] ** 2
            values, square = np.maximum(values, 0.0) * tempered[:, None], square * tempered[:, None] ** 2
            s = np.stack([group.sizes for group in alike])[:, :, None] ** 2
            likelihood = 0.5 * (s * square[:, None] / (1.0 + s * values[:, None]) - np.log1p(s * values[:, None]))
            odds = np.array([group.log_odds for group in alike]) - math.log(SIZES)
            found |= dict(zip(alike, odds[:, None] + likelihood.sum(axis=-1), strict=True))
        return [found[group] for group in groups]

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
        sets, rng = self._sets(grams), np.random.default_rng(0)
        (first, _), count = sets[0], len(sets[0][0].used)
        errors, real = np.zeros((DRAWS, count)), np.zeros(DRAWS, bool)
        of_set = np.searchsorted(np.cumsum([probability for _, probability in sets]), rng.random(DRAWS))
        for number, (posterior, _) in enumerate(sets):
            drawn = np.flatnonzero(of_set == number)
            if not drawn.size:
                continue
            own, there = np.zeros((drawn.size, len(posterior.used))), np.zeros(drawn.size, bool)
            for group in self._averaged(posterior):
                evidence, biases, roots = zip(*self._cases(posterior, group), strict=True)
                weights = np.exp(np.array([0.0, *evidence]) - max(0.0, *evidence))
                size = np.searchsorted(np.cumsum(weights / weights.sum()), rng.random(drawn.size)) - 1
                for case, (bias, root) in enumerate(zip(biases, roots, strict=True)):
                    here = size == case
                    own[here] += bias + rng.standard_normal((int(here.sum()), root.shape[1])) @ root.T
                    there |= here
            if posterior is first:
                errors[drawn], real[drawn] = own, there
                continue
            real[drawn] = True
            places = [place for place in first.used if place in posterior.used]
            one, other = ([each.used.index(place) for place in places] for each in (first, posterior))
            errors[drawn] -= first.mean
            wider = posterior.covariance[np.ix_(other, other)] - first.covariance[np.ix_(one, one)]
            scale = np.sqrt(np.diag(first.covariance))[one]
            values, vectors = np.linalg.eigh(wider / np.outer(scale, scale))
            root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
            own = own[:, other] + posterior.mean[other]
            errors[np.ix_(drawn, one)] += own + rng.standard_normal(own.shape) @ root.T
        if not real.any():
            return None
        count = int(real.sum())
        return HiddenMotions(np.full(count, 1.0 / DRAWS), errors[real], np.zeros((count, errors.shape[1], 1)))

    def _sets(self, grams: ViewGrams) -> list[tuple[Posterior, float]]:
        """Return the likely sets of motions with their probabilities, the set that is fitted first."""
        current = self._with_places(grams)
        sets = self._explored(current) if self.of_sets else [current]
        own = set(current.sizes)
        sets = [current, *(each for each in sets if set(each.sizes) != own)]
        weights = np.array([self._tempered(each).log_likelihood for each in sets])
        weights = np.exp(weights - weights.max())
        weights /= weights.sum()
        kept = [n for n, weight in enumerate(weights) if n == 0 or weight > LEAST_PROBABILITY]
        return [(sets[n], float(weights[n] / weights[kept].sum())) for n in kept]

    def _tempered(self, posterior: Posterior) -> Posterior:
        """Return the posterior with the variance by which sets are compared, the same for all."""
        return replace(posterior, variance=max(posterior.variance, self.structured / STRUCTURES))

    def _explored(self, current: Posterior) -> list[Posterior]:
        """Return sets of motions: from several starts, and next to the best of these."""
        groups = [*self.groups, *self.placed]
        motions = [group for group in groups if group.one.effect.adjustment in MOTIONS]
        if not any(group in current.sizes for group in motions) and not any(
            evidence.max() > SUSPECTED for evidence in self._evidences(current, motions)
        ):
            return [current]
        still = current
        for group in motions:
            still = still.resized(group, 0.0)
        starts = [
            [group for group in motions if group.one.effect.adjustment in kinds and len(group.one.columns) in widths]
            for kinds, widths in STARTS
        ]
        found: dict[frozenset[Group], Posterior] = {}

        def climb(start: Posterior, barred: Collection[Group] = ()) -> Posterior:
            end = self._climbed(start, groups, MOST_MOTIONS, barred)
            return found.setdefault(frozenset(end.sizes), end)

        climb(current)
        climb(still)
        for start in starts:
            climb(self._climbed(still, start, MOST_MOTIONS))
        looked: set[frozenset[Group]] = set()
        for _ in range(LEFT):
            left = [each for each in found.values() if frozenset(each.sizes) not in looked]
            if not left:
                break
            best = max(left, key=lambda each: self._tempered(each).log_likelihood)
            looked.add(frozenset(best.sizes))
            for group in [one for one in best.sizes if one in motions]:
                climb(best.resized(group, 0.0), [group])
        return list(found.values())

    def likelier_set(self) -> bool:
        """Go over to a set of motions that is likelier than the fitted one, if there is one; return whether."""
        current = self._with_places(self.last[-1])
        sets = self._explored(current)
        best = max(sets, key=lambda each: self._tempered(each).log_likelihood)
        gained = self._tempered(best).log_likelihood - self._tempered(current).log_likelihood
        if set(best.sizes) == set(current.sizes) or gained <= BETTER:
            return False
        self._adopt(best, self.last[1])
        here = {module.first_cell for module in self.model.data.cells.modules}
        further = [DetectorModule(cell) for cell in sorted(first_cells_of(self.fitted) - here)]
        self.model = with_modules(self.model, (*self.model.data.cells.modules, *further))
        self.rounds = 0
        return True

    def _with_places(self, grams: ViewGrams) -> Posterior:
        """Return the last posterior next to slips at some views."""
        last, columns = self.posterior, list(self.posterior.system.columns)
        views = places_of_slips(len(grams.scores)) if Adjustment.SLIP not in self.without else []
        self.placed = []
        known = {one.effect.reason(self.model, np.ones(len(one.columns))).values["view"] for one in self._slips}
        count = len(grams.scores)
        pursued = self._pursued(grams) if self.of_sets else []
        near = pursued + [view + by for view in known for by in NEAR_VIEWS if 0 < view + by < count]
        for view in sorted({*views, *near}):
            for effect in (slip_at(view), jump_at(view)):
                if any(self._same(effect, other) for other in self._slips):
                    continue
                one = Fitted(effect, effect.columns(self.model), float(len(views) if view in views else count))
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

    def _pursued(self, grams: ViewGrams) -> list[int]:
        """Return the views of several slips that together explain most where nothing else moves."""
        columns = list(self.posterior.system.columns)
        at = np.zeros(len(columns))
        for group in self.groups:
            at[group.one.places] = group.one.sizes
        moving = {place for group in self.groups if group.one.effect.adjustment in MOTIONS for place in group.one.places}
        last = set(self.posterior.used)
        kept = [place for place in range(len(columns)) if place in last and place not in moving]
        steps = [slip_at(view).columns(self.model) for view in range(len(grams.scores))]
        views: list[int] = []

        def likeliest(others: Sequence[int]) -> int | None:
            some = [columns[place] for place in kept] + [column for view in others for column in steps[view]]
            moved_columns = [columns[place] for place in sorted(moving) if at[place]]
            by = at[[place for place in sorted(moving) if at[place]]]
            of_all, scores = grams.of_columns([*some, *moved_columns])
            count = len(some)
            return likeliest_slip(some, of_all[:, :count, :count], scores[:, :count] + of_all[:, :count, count:] @ by)

        for _ in range(MOST_SLIPS):
            view = likeliest(views)
            if view is None or view in views:
                break
            views.append(view)
        for number in range(len(views) if len(views) > 1 else 0):
            view = likeliest([*views[:number], *views[number + 1 :]])
            if view is not None and view not in views:
                views[number] = view
        return views

    @property
    def _slips(self) -> list[Fitted]:
        return [group.one for group in self.groups if group.one.effect.adjustment is Adjustment.SLIP]

    def _same(self, effect: Effect, other: Fitted) -> bool:
        columns = effect.columns(self.model)
        if len(columns) != len(other.columns):
            return False
        return all(
            np.array_equal(a[1], b[1])
            for one, two in zip(columns, other.columns, strict=True)
            for a, b in zip(one.parts, two.parts, strict=True)
        )

    def _averaged(self, posterior: Posterior) -> Iterator[Group]:
        for group in self.groups:
            searched = is_module(group.one) or group.one.effect.adjustment is Adjustment.SLIP
            if group in posterior.sizes or not searched:
                yield group
        yield from (group for group in self.placed if group in posterior.sizes or group.one.trials < self.views)

    def _cases(self, posterior: Posterior, group: Group) -> Iterator[tuple[float, FloatArray, FloatArray]]:
        """Yield evidence, bias and root of the covariance that other sizes of a group add to the fitted columns."""
        evidence = self._evidence(posterior, group)
        information, score = posterior.left(group)
        if group in posterior.sizes:
            current = group.at(evidence, posterior.sizes[group])
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
    """Fit geometry and groups from the plain fit, from one start; groups in `without` are left out."""
    return _fitted(MixtureFitter(prepared, frozenset(without), of_sets=False), on_step)


def fit_sets(
    prepared: AdjustedFit, without: Collection[Adjustment] = (), on_step: OnStep = ignore_progress
) -> JointFit:
    """Fit geometry and groups from the plain fit, with sets of motions from several starts."""
    return _fitted(MixtureFitter(prepared, frozenset(without), of_sets=True), on_step)


def _fitted(fitter: MixtureFitter, on_step: OnStep) -> JointFit:
    fitter.fit(on_step)
    if fitter.shows(OF_WOOD):
        fitter.widened()
        fitter.fit(on_step)
    if Adjustment.WOOD_DENSITY not in fitter.without and fitter.shows_varying_density():
        fitter.widened(patches=True)
        fitter.fit(on_step)
    for _ in range(OTHER_SETS if fitter.of_sets else 0):
        if not fitter.likelier_set():
            break
        fitter.fit(on_step)
    return fitter.result()
