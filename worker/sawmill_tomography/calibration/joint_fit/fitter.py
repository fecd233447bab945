"""The geometry and every effect that the scan shows, fitted together by generalised least squares.

The fit takes Gauss-Newton steps from the plain fit. At each point every effect of `faults.effects` is tested by its own
pattern; an effect that chance does not explain joins the fit. An effect that is beyond chance but not fitted adds a
bias to the covariance.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from itertools import accumulate, chain, pairwise

import numpy as np

from sawmill_tomography.calibration.faults.effects import EFFECTS, OF_WOOD, Effect
from sawmill_tomography.calibration.faults.finding import AdjustedFit
from sawmill_tomography.calibration.faults.hidden_motions import HiddenMotions, MotionKind, hidden_motions
from sawmill_tomography.calibration.faults.intensity_averaging import averaging
from sawmill_tomography.calibration.faults.modules import (
    FEWEST_CELLS,
    HIDDEN,
    HiddenModule,
    ModuleSearch,
    effect_of,
    with_modules,
)
from sawmill_tomography.calibration.faults.outliers import (
    inconsistent_views,
    views_differ,
    without_views,
)
from sawmill_tomography.calibration.faults.slip import angle_scatter, jump_at, likeliest_slip, places_of_slips, slip_at
from sawmill_tomography.calibration.fit import OnStep, ignore_progress
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.normal_equations import UNTRUSTED, Column, System, ViewGrams
from sawmill_tomography.calibration.joint_fit.readings import (
    MOTIONS,
    Fitted,
    first_cells_of,
    is_module,
    other_motions,
    other_reading,
)
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, Term
from sawmill_tomography.calibration.joint_fit.selection import (
    BEYOND_CHANCE,
    FITTED,
    ON_DETECTOR,
    STRUCTURES,
    EffectTest,
    EffectTester,
    chance_limit,
)
from sawmill_tomography.calibration.joint_fit.steps import BY_ANGLES, ROUNDING, is_small, moved, off_by, stepped
from sawmill_tomography.calibration.joint_fit.wood_patches import Variation
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment, DetectorModule
from sawmill_vocabulary.scan_messages import AdjustmentMessage

ROUNDS = 12
VIEW_ROUNDS = 3
# Effects join in the first JOINING rounds, at most MOST_AT_ONCE in each: what several effects explain together is only
# known to first order.
JOINING, MOST_AT_ONCE = 6, 2
# A fit that ends before a step is small is good enough where the next step would move the geometry by no more than
# this many standard deviations, squared.
TOLERABLE = 25.0
MOST_SLIPS = 2
# Effects of wood are first looked for in this number of views, and not where neighbouring cells of the residual have
# products whose mean is within this number of standard deviations of 0.
SCREENED_VIEWS, UNCORRELATED = 20, 1.0
# Densities of the wood's patches are fitted where they explain more than this share of the structured residual.
LEAST_EXPLAINED = 0.5
# The largest number of effects that join together.
MOST_TOGETHER = 6
# Modules change the sinogram by at least this share (RMS): rounding errors of a scan without noise are no gaps. A gap
# of a tenth of a cell in the middle of the shadow makes up 0.0008.
LEAST_OF_MODULES = 2e-4
# Borders between modules move in the rounds before this one.
LATEST_MOVE = 9
# A module is likelier beforehand than another effect: its limit of chance is this much larger (benchmarks/families.py).
MODULE_TRIALS = 0.1
# A detector may hide one module, and this number of further ones where the scan shows fewer than `MANY_FOUND`
# (benchmarks/families.py).
FURTHER_HIDDEN, MANY_FOUND = 2, 2
# A curvature of the detector is reported where it explains more than this number of variances and its radius is smaller
# than this. Of 40 scans of straight detectors that ended one explained more, with a radius of 29 m; of modules in a fit
# that has not ended, 19 m (benchmarks/families.py --seed 977). An arc about the source explains 180, next to the
# wobbles that are fitted in its place (tests/tomography/calibration/test_cell_order.py).
ARC, LARGEST_ARC_MM = 30.0, 10_000.0
# The largest number of modules that are searched for in addition to the known ones.
MOST_MODULES = 8


def fit_jointly(
    prepared: AdjustedFit, without: Collection[Adjustment] = (), on_step: OnStep = ignore_progress
) -> JointFit:
    """Fit geometry and effects from the plain fit; effects in `without` are tested, and not fitted.

    Where effects of real wood are beyond chance next to this fit, the fit is repeated with them from the start: other
    effects may have joined in their place. So it is where the wood's density varies from place to place, with a density
    of each patch.
    """
    fitter = JointFitter(prepared, frozenset(without), EFFECTS)
    fitter.fit(on_step)
    if fitter.shows(OF_WOOD):
        fitter = JointFitter(prepared, frozenset(without), (*EFFECTS, *OF_WOOD))
        fitter.fit(on_step)
    if Adjustment.WOOD_DENSITY not in without and fitter.shows_varying_density():
        fitter = JointFitter(prepared, frozenset(without), (*EFFECTS, *OF_WOOD), of_patches=True)
        fitter.fit(on_step)
    return fitter.result()


FitJointly = Callable[[AdjustedFit, Collection[Adjustment], OnStep], JointFit]


def fit_consistent_views(
    prepared: AdjustedFit,
    without: Collection[Adjustment] = (),
    on_step: OnStep = ignore_progress,
    fit: FitJointly = fit_jointly,
) -> tuple[AdjustedFit, JointFit]:
    """Fit as `fit_jointly` does, leaving out the few views that a fit to the remaining views does not explain."""
    joint = fit(prepared, without, on_step)
    left_out = np.zeros(len(prepared.data.sinogram), bool)
    for _ in range(VIEW_ROUNDS if Adjustment.OUTLIERS not in without else 0):
        inconsistent = (
            inconsistent_views(joint.model.residual, joint.model.data.sinogram, joint.model.data.weights) & ~left_out
        )
        remaining = without_views(prepared, left_out | inconsistent) if inconsistent.any() else None
        if remaining is None:
            break
        left_out |= inconsistent
        joint = fit(remaining, without, on_step)
    if not left_out.any():
        return prepared, joint
    remaining = replace(
        prepared, adjustments=(*prepared.adjustments, AdjustmentMessage.INCONSISTENT_VIEWS(views=int(left_out.sum())))
    )
    # A further fit finds the modules again, with their errors.
    return replace(remaining, data=replace(joint.model.data, cells=prepared.data.cells)), joint


class JointFitter:
    """The current model, the effects in the model and the effects that may still join."""

    def __init__(
        self,
        prepared: AdjustedFit,
        without: frozenset[Adjustment],
        effects: Sequence[Effect],
        *,
        of_patches: bool = False,
    ) -> None:
        start, views = prepared.fit, len(prepared.data.sinogram)
        self.without = without
        self.model = ScanModel(
            prepared.phantom,
            prepared.data,
            prepared.from_counts,
            start.to_vector(),
            np.full((views, 1), start.gain),
            np.full((views, 1), start.offset),
            np.zeros((views, 3)),
        )
        held = {Term(p) for p in start.covariance.held}
        self.base = [Column.of(term) for term in Term if term <= Term.OFFSET and term not in held]
        self.waiting = self._of_effects(effects)
        self.of_wood = effects is not EFFECTS
        self.variation: Variation | None = None
        self.of_patches = of_patches
        self.known_modules = {module.first_cell for module in prepared.data.cells.modules}
        for module in prepared.data.cells.modules:
            self.waiting.append(self._of_module(module, 1.0))
        self.unneeded: set[int] = set()
        self.searched: tuple[ViewGrams, list[int], ModuleSearch] | None = None
        self.fitted: list[Fitted] = []
        for known in prepared.known:
            self.fitted.append(Fitted(known.effect, known.effect.columns(self.model)))
            self.fitted[-1].sizes = known.sizes
            self.waiting = [one for one in self.waiting if one.effect.columns is not known.effect.columns]
        self.averaging = prepared.averaging
        self.angle_variance, self.variance, self.converged = 0.0, 0.0, False
        self.correlation = 0.0
        self.rounds = 0

    def _of_effects(self, effects: Sequence[Effect]) -> list[Fitted]:
        return [
            Fitted(effect, columns, declined=effect.adjustment in self.without)
            for effect in effects
            if (columns := effect.columns(self.model))
        ]

    def fit(self, on_step: OnStep) -> None:
        """Take steps until the fit has ended."""
        while self.rounds < ROUNDS and not self.round():
            on_step()

    def shows(self, effects: Sequence[Effect]) -> bool:
        """Return whether some of the views show one of these effects next to a fit that has ended.

        Only a fit with effects, or with a residual whose neighbouring cells resemble each other, is looked at: the
        effects may have joined in place of these.
        """
        if not self.fitted and self.correlation <= UNCORRELATED:
            return False
        grams = ViewGrams(self.model.every(self._screening_step), of_wood=True)
        base = self._screened(grams)
        tried = [one.columns for one in self._of_effects(effects)]
        tester = EffectTester(grams.system([*base, *chain.from_iterable(tried)]), range(len(base)))
        ends = accumulate(map(len, tried), initial=len(base))
        return any(tester.tested(range(start, end)).is_beyond_chance() for start, end in pairwise(ends))

    def shows_varying_density(self) -> bool:
        """Return whether some of the views show, next to a fit that has ended, that the wood's density varies."""
        system, _, used, *_ = self.last
        if system.structured / STRUCTURES <= system.variance(used):
            return False
        model = self.model.every(self._screening_step)
        grams = ViewGrams(model, of_wood=self.of_wood, of_patches=True)
        columns = self._screened(grams)
        uniform, own = grams.system(columns), range(len(columns))
        if not _varies(grams.vary_densities(columns)):
            return False
        explained = uniform.remaining(own) - grams.system(columns).remaining(own)
        return explained > LEAST_EXPLAINED * uniform.structured

    @property
    def _screening_step(self) -> int:
        return max(len(self.model.data.angles_rad) // SCREENED_VIEWS, 1)

    def _screened(self, grams: ViewGrams) -> list[Column]:
        """Return the fit's columns in the views that are looked at first, without the views' random effects."""
        fitted = (column.every(self._screening_step) for one in self.fitted for column in one.columns)
        return [*self._project_out(grams), *fitted]

    def round(self) -> bool:
        """Let significant effects join, and take one step; return whether the fit has ended."""
        self.rounds += 1
        grams, free = self._linearised()
        system, tried, used = self._system(grams, free)
        if self._relocated_modules(grams, system, used):
            grams, free = self._linearised()
            system, tried, used = self._system(grams, free)
        further = self._further_modules(grams, system, used)
        if further:
            self.waiting += further
            grams, free = self._linearised()
            system, tried, used = self._system(grams, free)
        joined, tests = self._join(system, tried, used)
        if not joined:
            joined = self._join_together(system, tried, used)
            tests = _tests(system, tried, used, joined) if joined else tests
        if further:
            self.waiting = [one for one in self.waiting if one not in further]
            self.model = self._with_fitted_modules()
        change = _best_change(system, used)
        remaining = max(system.power - float(change @ system.score), 0.0)
        self.variance = remaining / max(system.samples - len(used), 1.0)
        small = is_small(self.model, system, used, change, self.variance)
        may_rise = BY_ANGLES if small or self.angle_variance > 0.0 or self.of_patches else ROUNDING
        self.model, share = stepped(self.model, *system.with_patches(change), grams, may_rise=may_rise)
        for one in self.fitted:
            one.sizes = one.sizes + share * change[one.places]
        self.last = system, tried, used, change, tests, grams
        self.converged = off_by(system, used, change) <= TOLERABLE * self.variance
        if share == 0.0:
            return True
        if share < 1.0 or joined or not small:
            return False
        self.converged = self._settled(system, used, change) and not self._moved_borders(grams, system, used)
        return self.converged

    def result(self) -> JointFit:
        """Return the end point of the fit."""
        system, tried, used, change, tests, grams = self.last
        allowed = [one for one in tried if one.effect.adjustment not in self.without]
        other = other_reading(system, used, self.fitted, allowed)
        beyond_chance = tuple(
            (one, test)
            for one, test in tests
            if (other is None or one is not other.other) and not is_module(one) and test.is_beyond_chance(one.trials)
        )
        return JointFit(
            self._with_fitted_modules(),
            tuple(self.fitted),
            system,
            used,
            change,
            self.variance,
            beyond_chance,
            other,
            tuple(other_motions(system, used, self.fitted, [one for one in allowed if one in self.waiting])),
            self.angle_variance,
            self.variation if self.variation is not None and _varies(self.variation) else None,
            tuple(self._hidden_modules(grams, system, used)),
            self._hidden_motions(grams, system, tests, used),
            self._arc_radius_mm(grams, system, used),
            converged=self.converged,
            rounds=self.rounds,
        )

    def _linearised(self) -> tuple[ViewGrams, list[Column]]:
        """Compute the derivatives' inner products, without views' random effects, and the columns always fitted."""
        grams = self._grams()
        if not self.model.view_gain and Adjustment.VIEW_GAIN not in self.without and views_differ(grams):
            self.model = self.model.with_view_gains(grams.weights)
            grams = self._grams()
        self.correlation = grams.correlation
        return grams, self._project_out(grams)

    def _grams(self) -> ViewGrams:
        return ViewGrams(self.model, of_wood=self.of_wood, of_patches=self.of_patches)

    def _project_out(self, grams: ViewGrams) -> list[Column]:
        """Project out the views' random effects, and return the columns always fitted."""
        if self.angle_variance > 0.0:
            grams.project_out([Term.PSI], self.variance / self.angle_variance)
        if self.model.view_gain:
            grams.project_out([Term.GAIN, Term.OFFSET], 0.0)
            return [column for column in self.base if column.term not in (Term.GAIN, Term.OFFSET)]
        of_offset, of_sample = grams.offset_variance()
        if of_offset > 0.0:
            grams.project_out([Term.OFFSET], of_sample / of_offset)
        return self.base

    def _system(self, grams: ViewGrams, free: list[Column]) -> tuple[System, list[Fitted], list[int]]:
        """Return the normal equations of all columns, the effects to be tested, and the indices of the fitted columns.

        The likeliest slip is among the effects to be tested.
        """
        tried = list(self.waiting)
        base = [*free, *(column for one in self.fitted for column in one.columns)]
        used = list(range(len(base)))
        slips = sum(one.effect.adjustment is Adjustment.SLIP for one in self.fitted)
        if self.of_patches:
            self.variation = grams.vary_densities(base)
        view = likeliest_slip(base, *grams.of_columns(base)) if slips < MOST_SLIPS else None
        if view is not None:
            trials, declined = float(len(grams.scores)), Adjustment.SLIP in self.without
            tried += [
                Fitted(effect, effect.columns(self.model), trials, declined=declined)
                for effect in (slip_at(view), jump_at(view))
            ]
        system = grams.system([*base, *(column for one in tried for column in one.columns)])
        first = len(free)
        for one in (*self.fitted, *tried):
            one.places = list(range(first, first := first + len(one.columns)))
        return system, tried, used

    def _of_module(self, module: DetectorModule, trials: float) -> Fitted:
        effect = effect_of(module, self.model.data.cells.width_mm)
        return Fitted(effect, effect.columns(self.model), trials, declined=Adjustment.MODULES in self.without)

    def _with_fitted_modules(self) -> ScanModel:
        """Return the model with the known modules and those that are fitted."""
        kept = self.known_modules | first_cells_of(self.fitted)
        return with_modules(self.model, (one for one in self.model.data.cells.modules if one.first_cell in kept))

    @property
    def _found_modules(self) -> list[tuple[Fitted, DetectorModule]]:
        """The effects of the modules that were found, each with its module."""
        modules = {one.first_cell: one for one in self.model.data.cells.modules}
        found = ((one, cell) for one in self.fitted for cell in first_cells_of([one]) - self.known_modules)
        return [(one, modules[cell]) for one, cell in found]

    def _module_search(self, grams: ViewGrams, system: System, used: list[int]) -> ModuleSearch:
        """Return the search next to these columns, which is made once for the derivatives of a round."""
        if self.searched is None or self.searched[0] is not grams or self.searched[1] != used:
            self.searched = grams, list(used), ModuleSearch(self.model, grams, system, used, self.unneeded)
        return self.searched[2]

    def _further_modules(self, grams: ViewGrams, system: System, used: list[int]) -> list[Fitted]:
        """Put the likeliest further modules of the detector into the model, and return their effects."""
        cells = self.model.data.cells
        most = MOST_MODULES - len(cells.modules)
        if Adjustment.MODULES in self.without or self.rounds > JOINING or most <= 0:
            return []
        search = self._module_search(grams, system, used)
        modules = [DetectorModule(cell) for cell in search.likeliest(self._module_by_chance(system, used), most)]
        if modules:
            self.model = with_modules(self.model, (*cells.modules, *modules))
        return [self._of_module(module, MODULE_TRIALS * self._places_of_modules) for module in modules]

    def _arc_radius_mm(self, grams: ViewGrams, system: System, used: list[int]) -> float | None:
        """Return the radius of an arc on which the cells seem to lie, mm; None where the scan does not show one."""
        variance = _variance_on_detector(system, used)
        if Adjustment.MODULES in self.without or variance <= 0.0:
            return None
        curvature, power = self._module_search(grams, system, used).curvature(self.model.frame)
        shown = power > ARC * variance and abs(curvature) * LARGEST_ARC_MM > 1.0
        return 1.0 / abs(curvature) if shown else None

    @property
    def _places_of_modules(self) -> float:
        """Number of places at which a module may begin: borders that are less than a module apart count as one."""
        return self.model.data.cells.count / FEWEST_CELLS

    def _module_by_chance(self, system: System, used: list[int]) -> float:
        """Return the power that a gap or a kink explains by chance, or by rounding errors, at its likeliest place."""
        variance = _variance_on_detector(system, used)
        rounding = system.samples * (LEAST_OF_MODULES * float(self.model.data.sinogram.std())) ** 2
        return max(variance * chance_limit(BEYOND_CHANCE / self._places_of_modules, 1), rounding)

    def _hidden_modules(self, grams: ViewGrams, system: System, used: list[int]) -> Iterator[tuple[HiddenModule, ...]]:
        """Yield the modules that the scan may hide, and for each that it shows the places at which it may begin."""
        if Adjustment.MODULES in self.without:
            return
        variance = _variance_on_detector(system, used)
        if variance <= 0.0:
            return
        search, found = self._module_search(grams, system, used), [module for _, module in self._found_modules]
        hidden = tuple(search.hidden(variance, HIDDEN))
        yield hidden
        # A detector that shows none hides further ones as far as the first does not take the evidence: the wood's
        # structure looks like one.
        left = 1.0 if found else 1.0 - sum(float(one.probabilities.sum()) for one in hidden) ** 2
        for _ in range(FURTHER_HIDDEN if len(found) < MANY_FOUND else 0):
            yield tuple(replace(one, probabilities=left * one.probabilities) for one in hidden)
        for module in sorted(found, key=lambda one: one.first_cell):
            yield tuple(search.elsewhere(module, variance))

    def _hidden_motions(
        self, grams: ViewGrams, system: System, tests: Sequence[tuple[Fitted, EffectTest]], used: list[int]
    ) -> HiddenMotions | None:
        """Find the motions that the scan may hide: those that were tested, and slips at some views.

        A slip at any view has the variance of the one that was tested.
        """
        variance = max(system.variance(used), UNTRUSTED * system.structured / STRUCTURES)
        if variance <= 0.0:
            return None
        by_chance = {one: max(variance, test.variance) for one, test in tests}
        allowed, tester = MOTIONS - self.without, EffectTester(system, used)
        kinds = [
            MotionKind(tester, [one], by_chance[one])
            for one, _ in tests
            if one in self.waiting and one.effect.adjustment in allowed - {Adjustment.SLIP}
        ]
        views = places_of_slips(len(grams.scores)) if Adjustment.SLIP in allowed else []
        if views:
            columns = [system.columns[place] for place in used]
            slips = [[self._at(columns, effect(view)) for view in views] for effect in (slip_at, jump_at)]
            tester = EffectTester(grams.system(columns), range(len(used)))
            for kind in slips:
                alike = (
                    by_chance[one] for one, _ in tests if _is_slip(one) and len(one.columns) == len(kind[0].columns)
                )
                kinds.append(MotionKind(tester, kind, max(alike, default=variance)))
        return hidden_motions(kinds, self.model.drawing.radius_mm)

    def _at(self, columns: list[Column], effect: Effect) -> Fitted:
        """Append the columns of an effect, and return the effect with their places."""
        one = Fitted(effect, effect.columns(self.model))
        columns += one.columns
        one.places = list(range(len(columns) - len(one.columns), len(columns)))
        return one

    def _relocated_modules(self, grams: ViewGrams, system: System, used: list[int]) -> bool:
        """Move a found module to where it explains more next to all else; return whether one has moved.

        A module that is found first stands in for others, and for effects that join later.
        """
        if not self._found_modules or self.rounds > JOINING:
            return False
        search, by_chance = self._module_search(grams, system, used), self._module_by_chance(system, used)
        for one, module in self._found_modules:
            better = search.relocated(module, by_chance)
            if better != module.first_cell:
                self._move(one, module, better)
                return True
        return False

    def _move(self, one: Fitted, module: DetectorModule, first_cell: int) -> None:
        """Let a found module begin at another cell."""
        others = [other for other in self.model.data.cells.modules if other.first_cell != module.first_cell]
        self.model = with_modules(self.model, (*others, replace(module, first_cell=first_cell)))
        again = self._of_module(DetectorModule(first_cell), one.trials)
        again.sizes = one.sizes
        self.fitted[self.fitted.index(one)] = again

    def _moved_borders(self, grams: ViewGrams, system: System, used: list[int]) -> bool:
        """Locate the borders of the modules that were found; return whether one has moved."""
        if not self._found_modules:
            return False
        # `result` uses this search, which is of the model before its last step.
        search, moved = self._module_search(grams, system, used), False
        if self.rounds >= LATEST_MOVE:
            return False
        for one, module in self._found_modules:
            better = search.border(module)
            others = [each.first_cell for each in self.model.data.cells.modules if each.first_cell != module.first_cell]
            if better != module.first_cell and all(abs(better - other) >= FEWEST_CELLS for other in others):
                self._move(one, module, better)
                moved = True
        return moved

    def _join(
        self, system: System, tried: Sequence[Fitted], used: list[int]
    ) -> tuple[list[Fitted], list[tuple[Fitted, EffectTest]]]:
        """Let effects join, each time the one that explains most; return the new effects, and the tests of the rest.

        The columns of the new effects are appended to `used`. Modules join no fit together with other effects: before
        those are fitted, the likeliest module is often where there is none.
        """
        joined: list[Fitted] = []
        while True:
            tests = _tests(system, tried, used, joined)
            worth = [
                (test.power, one)
                for one, test in tests
                if test.is_fitted(one.trials)
                and one.may_join(self.model, test)
                and all(is_module(one) == is_module(other) for other in joined)
            ]
            if not worth or len(joined) == MOST_AT_ONCE or self.rounds > JOINING:
                break
            _, best = max(worth, key=lambda pair: pair[0])
            joined.append(best)
            used += best.places
        self._take(joined, tried)
        return joined, tests

    def _take(self, joined: Sequence[Fitted], tried: Sequence[Fitted]) -> None:
        """Take effects into the fit; the other effect of a slip's view stays among those to be tested."""
        self.fitted += joined
        self.waiting = [one for one in self.waiting if one not in joined]
        if any(one.effect.adjustment is Adjustment.SLIP for one in joined):
            self.waiting += [
                one for one in tried if one.effect.adjustment is Adjustment.SLIP and one not in (*joined, *self.waiting)
            ]

    def _join_together(self, system: System, tried: Sequence[Fitted], used: list[int]) -> list[Fitted]:
        """Let several effects join that only together explain what is left: each hides the others.

        Every effect that noise does not explain is tried with the others, a module also where its gap and kink alone
        are not possible: those of neighbouring modules hide each other. Then those that are not needed go, the least
        first, and those that are not possible.
        """
        if self.rounds > JOINING or system.structured / STRUCTURES < system.remaining(used) / system.samples:
            return []
        group: list[Fitted] = []
        while len(group) < MOST_TOGETHER:
            places = [*used, *(place for one in group for place in one.places)]
            variance, tester = system.variance(places), EffectTester(system, places)
            tests = [(tester.tested(one.places), one) for one in tried if one not in group]
            worth = [
                (test.power, one)
                for test, one in tests
                if test.degrees
                and test.power > variance * chance_limit(FITTED / one.trials, test.degrees)
                and (one.may_join(self.model, test) or (is_module(one) and not one.declined))
            ]
            if not worth:
                break
            group.append(max(worth, key=lambda pair: pair[0])[1])
        while group:
            needed = []
            for one in group:
                rest = [*used, *(place for other in group if other is not one for place in other.places)]
                needed.append((EffectTester(system, rest).tested(one.places).over_limit(one.trials), one))
            least, weakest = min(needed, key=lambda pair: pair[0])
            if least > 1.0:
                break
            group.remove(weakest)
        sizes = _best_change(system, [*used, *(place for one in group for place in one.places)])
        group = [one for one in group if one.effect.possible(self.model, sizes[one.places])]
        self._take(group, tried)
        used += [place for one in group for place in one.places]
        return group

    def _settled(self, system: System, used: list[int], change: FloatArray) -> bool:
        """Return whether every effect is needed, all scatter of angles is fitted, and averaging follows the model.

        Where something is missing, the model is changed and the fit continues.
        """
        dropped = self._explained(system, used)
        for one in dropped:
            self.model = moved(self.model, one.columns, -one.sizes)
            self.fitted.remove(one)
            if not first_cells_of([one]) - self.known_modules:
                self.waiting.append(Fitted(one.effect, one.columns, one.trials, declined=True))
        self.unneeded |= first_cells_of(dropped) - self.known_modules
        self.model = self._with_fitted_modules()
        if dropped:
            return False
        if self.angle_variance == 0.0 and Adjustment.ANGLE_JITTER not in self.without:
            self.angle_variance = angle_scatter(system, change, self.variance)
            if self.angle_variance > 0.0:
                return False
        if self.averaging is None or not self.fitted:
            return True
        self.model, self.averaging = _with_new_averaging(self.model, self.averaging), None
        return False

    def _explained(self, system: System, used: list[int]) -> list[Fitted]:
        """Return the effects that the others explain, the least needed first.

        Where effects are not possible, the least needed of them leaves alone: it has often spoiled the others.
        """
        impossible = [one for one in self.fitted if not one.effect.possible(self.model, one.sizes)]
        if impossible:
            return [min(impossible, key=lambda one: _need(system, used, one, []))]
        dropped: list[Fitted] = []
        while len(dropped) < len(self.fitted):
            kept = [one for one in self.fitted if one not in dropped]
            needed = [(_need(system, used, one, dropped), one) for one in kept]
            least, weakest = min(needed, key=lambda pair: pair[0])
            if least > 1.0:
                break
            dropped.append(weakest)
        return dropped


def _varies(variation: Variation) -> bool:
    return variation.likelihood > chance_limit(FITTED, 1)


def _best_change(system: System, used: list[int]) -> FloatArray:
    """Return the change of all columns that explains most where these are used, 0 for the others."""
    change = np.zeros(len(system.columns))
    change[used] = system.inverse(used) @ system.score[used]
    return change


def _tests(
    system: System, tried: Sequence[Fitted], used: list[int], joined: Sequence[Fitted]
) -> list[tuple[Fitted, EffectTest]]:
    """Test the effects that have not joined next to the fitted columns."""
    tester = EffectTester(system, used)
    return [(one, tester.tested(one.places)) for one in tried if one not in joined]


def _is_slip(one: Fitted) -> bool:
    return one.effect.adjustment is Adjustment.SLIP


def _variance_on_detector(system: System, used: list[int]) -> float:
    """Return the variance against which modules are judged: of noise, or their share of the structure."""
    return max(system.variance(used), UNTRUSTED * system.structured / ON_DETECTOR)


def _with_new_averaging(model: ScanModel, before: FloatArray) -> ScanModel:
    """Compute the averaging of intensities for the current model, and put it into the sinogram instead of `before`."""
    data = model.data
    position = model.pose[:, 1:] + model.x[[FitParameter.T_X, FitParameter.T_Y]]
    turned = replace(data, angles_rad=data.angles_rad + model.pose[:, 0])
    added = averaging(model.phantom, turned, model.frame, position_mm=position, gain=model.gain)
    return replace(model, data=replace(data, sinogram=data.sinogram - before + added))


def _need(system: System, used: list[int], one: Fitted, dropped: Sequence[Fitted]) -> float:
    """Return the significance of an effect next to the rest of the fit, without dropped effects, against its limit."""
    out = [*dropped, one]
    places = [place for each in out for place in each.places]
    without = system.without(places, np.concatenate([each.sizes for each in out]))
    return EffectTester(without, [i for i in used if i not in places]).tested(one.places).over_limit(one.trials)
