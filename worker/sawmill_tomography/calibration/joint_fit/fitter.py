"""The geometry and every effect that the scan shows, fitted together by generalised least squares.

The fit takes Gauss-Newton steps from the plain fit. At each point the likeliest groups of columns, and their sizes, are
those that are fitted (`groups.py`); the ends of several climbs are the sets of motions that may be real
(`motion_sets.py`).
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from itertools import accumulate, chain, compress, pairwise

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.fit import OnStep, ignore_progress
from sawmill_tomography.calibration.joint_fit.climb import Climb, scatter_of
from sawmill_tomography.calibration.joint_fit.effects import (
    EFFECTS,
    OF_WOOD,
    UNSTEADY_MOTIONS,
    Effect,
    is_beyond_drawing,
    places_of_cells,
)
from sawmill_tomography.calibration.joint_fit.finding import AdjustedFit
from sawmill_tomography.calibration.joint_fit.groups import (
    ON_DETECTOR,
    STRUCTURES,
    Fitted,
    Group,
    Posterior,
    first_cells_of,
    is_module,
    is_motion,
    is_on_detector,
)
from sawmill_tomography.calibration.joint_fit.intensity_averaging import averaging
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.modules import (
    FEWEST_CELLS,
    NEAR,
    HiddenModule,
    ModulePlaces,
    ModuleSearch,
    effect_of,
    with_modules,
)
from sawmill_tomography.calibration.joint_fit.motion_sets import MOST_SLIPS, FitPoint, MotionSets
from sawmill_tomography.calibration.joint_fit.normal_equations import UNTRUSTED, Column, System, ViewGrams
from sawmill_tomography.calibration.joint_fit.outliers import (
    inconsistent_views,
    views_differ,
    with_less_weight,
)
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, Term
from sawmill_tomography.calibration.joint_fit.selection import (
    BEYOND_CHANCE,
    FITTED,
    EffectTest,
    EffectTester,
    chance_limit,
)
from sawmill_tomography.calibration.joint_fit.slip import angle_scatter, jump_at, likeliest_slip, slip_at
from sawmill_tomography.calibration.joint_fit.steps import MOVED, moved, off_by, stepped
from sawmill_tomography.calibration.joint_fit.view_poses import (
    OF_TURNING,
    PoseSizes,
    likeliest_sizes,
    pose_change,
    project_out_poses,
    with_view_poses,
)
from sawmill_tomography.calibration.joint_fit.wood_patches import Variation, patch_side_mm, wood_patches
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment, DetectorModule
from sawmill_vocabulary.scan_messages import AdjustmentMessage

ROUNDS = 12
# Groups join in the first JOINING rounds, at most MOST_JOINING in each: what several explain together is only known to
# first order.
JOINING, MOST_JOINING = 6, 3
# A fit goes over to another set of motions at most this often, and once where the patches of the wood are fitted.
OTHER_SETS = 2
# A group that leaves the fit after this number of rounds does not join it again: what it would explain is much alike
# at the points with and without it, and the fit would go to and fro.
EARLY = 2
# In fewer views modules are only hidden ones: what few views leave looks like one.
FEWEST_VIEWS = 12
# Effects of wood are first looked for in this number of views, and not where neighbouring cells of the residual have
# products whose mean is within this number of standard deviations of 0.
SCREENED_VIEWS, UNCORRELATED = 20, 1.0
# Densities of patches may stand in the place of modules, an arc or waves where these gain less than this number of
# times the patches, as a logarithm of the likelihood (benchmarks/families.py).
OF_A_PATCH = 1.0
# Densities of the wood's patches are fitted where they explain more than this share of the structured residual.
LEAST_EXPLAINED = 0.5
# Noise and modules change the sinogram by at least this share (RMS): rounding errors of a scan without noise are no
# effects. A gap of a tenth of a cell in the middle of the shadow makes up 0.0008.
ROUNDING = 2e-4
# A module is likelier beforehand than another effect: its limit of chance is this much larger (benchmarks/families.py).
MODULE_TRIALS = 0.1
# A detector may hide one module, and further ones: the first number where the scan shows none, and the second where it
# shows fewer than that (benchmarks/families.py).
FURTHER_HIDDEN, FURTHER_THAN_FOUND = 2, 4
# Where no more is structured than the precision of the drawing leaves, an effect explains one of this number of shares
# by chance: the sides of a drawing are each off as a whole.
OF_DRAWING = 30.0
# The largest number of modules that are searched for in addition to the known ones.
MOST_MODULES = 8


def fit_jointly(
    prepared: AdjustedFit, without: Collection[Adjustment] = (), on_step: OnStep = ignore_progress
) -> "JointFitter":
    """Fit geometry and effects from the plain fit; effects in `without` are tested, and not fitted.

    Effects of real wood, and a density of each patch of it, are fitted where they are beyond chance.
    """
    fitter = JointFitter(prepared.by_noise, frozenset(without))
    fitter.begin(on_step)
    of_wood = fitter.copied()
    fitter.go_on(on_step)
    if fitter.may_be_of_wood:
        of_wood.widen(patches=True)
        # Where the wood varies, its patches are likelier by far after the first step (benchmarks/families.py).
        of_wood.fit(on_step, 1)
        if of_wood.is_likelier(fitter):
            of_wood.end(on_step)
            fitter = of_wood if of_wood.is_likelier(fitter) else fitter
    return fitter


def fit_consistent_views(
    prepared: AdjustedFit, without: Collection[Adjustment] = (), on_step: OnStep = ignore_progress
) -> tuple[AdjustedFit, JointFit]:
    """Fit as `fit_jointly` does, and go on without the few views that the others do not explain."""
    fitter = fit_jointly(prepared, without, on_step)
    if prepared.of_passages and Adjustment.OUTLIERS not in without:
        # Before the poses are known, each view in another pose is an outlier.
        before, prepared = prepared, with_less_weight(prepared, prepared, fitter.result().model.residual)
        fitter = fitter if prepared is before else fit_jointly(prepared, without, on_step)
    joint, left_out = fitter.result(), 0
    while Adjustment.OUTLIERS not in without and (views := inconsistent_views(joint.model)).any():
        left_out += int(views.sum())
        fitter.leave_out(views, on_step)
        joint = fitter.result()
    if not left_out:
        return prepared, joint
    adjustments = (*prepared.adjustments, AdjustmentMessage.INCONSISTENT_VIEWS(views=left_out))
    # A further fit finds the modules again, with their errors.
    data = replace(joint.model.data, cells=prepared.data.cells)
    return replace(prepared, data=data, adjustments=adjustments), joint


class JointFitter:
    """The current model, the effects in the model and the effects that may still join."""

    def __init__(self, prepared: AdjustedFit, without: frozenset[Adjustment]) -> None:
        start, views = prepared.fit, len(prepared.data.sinogram)
        # An object that is turned between passages does not move in the ways of one that turns.
        self.left_out = OF_TURNING if prepared.of_passages else frozenset[Adjustment]()
        self.without = without | self.left_out
        self.poses: PoseSizes | None = None
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
        self.waiting = self._of_effects(EFFECTS)
        self.variation: Variation | None = None
        self.of_wood = self.of_patches = False
        self.known_modules = {module.first_cell for module in prepared.data.cells.modules}
        self.prepared_cells = cells = prepared.data.cells
        # An arc, and waves.
        self.declared_places = [*compress(self._places_of_cells(), (cells.arc_radius_mm is not None, cells.waves_mm))]
        self.waiting += [*(self._of_module(module, 1.0) for module in cells.modules), *self.declared_places]
        self.unneeded: set[int] = set()
        self.begun: set[int] = set()
        self.searched: tuple[ViewGrams, list[int], ModuleSearch] | None = None
        self.placed: tuple[ScanModel, dict[DetectorModule, ModulePlaces]] = self.model, {}
        self.fitted: list[Fitted] = []
        for known in prepared.known:
            self.fitted.append(Fitted(known.effect, known.effect.columns(self.model)))
            self.fitted[-1].sizes = known.sizes
            self.waiting = [one for one in self.waiting if one.effect.columns is not known.effect.columns]
        # The sizes of the fitted groups' priors.
        self.size_of = {one: float(Group.of(one, self.model).sizes[-1]) for one in self.fitted}
        self.averaging = prepared.averaging
        self.angle_variance, self.variance, self.converged = 0.0, 0.0, False
        self.correlation = 0.0
        self.sets: MotionSets | None = None
        self.rounds, self.ended, self.gone = 0, False, set[Fitted]()

    def _of_effects(self, effects: Sequence[Effect]) -> list[Fitted]:
        return [
            Fitted(effect, columns, effect.trials, declined=effect.adjustment in self.without)
            for effect in effects
            if effect.adjustment not in self.left_out and (columns := effect.columns(self.model))
        ]

    def begin(self, on_step: OnStep) -> None:
        """Take the first steps, without the densities of patches.

        Other effects explain the wood until its patches are fitted, and leave again. Earlier, patches would explain
        motions (benchmarks/families.py), and what modules leave before their borders have moved.
        """
        if self.left_out:
            self.find_poses(on_step)
        self.fit(on_step, 2 * EARLY)

    def copied(self) -> "JointFitter":
        """Return a fit that continues from here by itself."""
        other, own = copy(self), {one: copy(one) for one in (*self.fitted, *self.waiting, *self.declared_places)}
        other.fitted, other.waiting, other.declared_places = (
            [own[one] for one in some] for some in (self.fitted, self.waiting, self.declared_places)
        )
        other.size_of = {own[one]: size for one, size in self.size_of.items()}
        other.begun, other.unneeded = set(self.begun), set(self.unneeded)
        return other

    def go_on(self, on_step: OnStep) -> None:
        """Fit to the end, with the effects of wood and the densities of patches where the scan shows them."""
        varies = not self.found_modules and self.shows_varying_density()
        if not varies:
            self.fit(on_step)
            self.go_over(on_step, 1)
            if self.shows(OF_WOOD):
                self.widen()
                self.fit(on_step)
            varies = self.shows_varying_density()
        if varies:
            self.widen(patches=True)
        self.end(on_step)

    def end(self, on_step: OnStep) -> None:
        """Fit until no other set of motions is likelier."""
        self.fit(on_step)
        if self.of_patches and self.left_out:
            # Wood of one density may have taken the other of two likely rolls.
            self.find_poses(on_step)
            self.fit(on_step)
        self.go_over(on_step, 1 if self.of_patches else OTHER_SETS)

    def leave_out(self, views: NDArray[np.bool_], on_step: OnStep) -> None:
        """Go on to the end without these views (views,)."""
        data = self.model.data
        weights = np.ones_like(data.sinogram) if data.weights is None else data.weights
        self.model = replace(self.model, data=replace(data, weights=np.where(views[:, None], 0.0, weights)))
        self._start_again()
        self.end(on_step)

    def find_poses(self, on_step: OnStep) -> None:
        """Find the poses of single views before any step."""
        self.rounds, self.ended = 0, False
        self.model = with_view_poses(self.model, self.base, ROUNDS, on_step)
        if self.averaging is not None:
            self.model, self.averaging = _with_new_averaging(self.model, self.averaging)
            self.model = with_view_poses(self.model, self.base, ROUNDS, on_step)

    def fit(self, on_step: OnStep, most: int = ROUNDS) -> None:
        """Take steps until the fit has ended, or up to this round."""
        while self.rounds < most and not self.ended:
            self.ended = self.round()
            on_step()

    def shows(self, effects: Sequence[Effect]) -> bool:
        """Return whether some of the views show one of these effects next to a fit that has ended.

        Only a fit with effects, or with a residual whose neighbouring cells resemble each other, is tested: the
        effects may have joined in place of these.
        """
        if self._within_drawing or (not self.fitted and self.correlation <= UNCORRELATED):
            return False
        model = self.model.every(self._screening_step)
        grams = ViewGrams(model, of_wood=True)
        base = self._screened(grams, model)
        tried = [one.columns for one in self._of_effects(effects)]
        tester = EffectTester(grams.system([*base, *chain.from_iterable(tried)]), range(len(base)))
        ends = accumulate(map(len, tried), initial=len(base))
        return any(tester.tested(range(start, end)).is_beyond_chance(BEYOND_CHANCE) for start, end in pairwise(ends))

    def shows_varying_density(self) -> bool:
        """Return whether some of the views show, next to the last step, that the wood's density varies."""
        system, posterior, *_ = self.last
        if (
            Adjustment.WOOD_DENSITY in self.without
            or self._within_drawing
            or system.structured / STRUCTURES <= system.variance(posterior.used)
        ):
            return False
        model = self.model.every(self._screening_step)
        grams = ViewGrams(model, of_wood=self.of_wood, of_patches=True)
        columns = self._screened(grams, model)
        uniform, own = grams.system(columns), range(len(columns))
        varies = grams.vary_densities(columns)
        drawing = self.model.drawing
        # Patches change the rays as an outline does that is off by their side times the variation.
        if not _varies(varies) or varies.deviation * patch_side_mm(drawing) <= drawing.precision_mm:
            return False
        return uniform.remaining(own) - grams.system(columns).remaining(own) > LEAST_EXPLAINED * uniform.structured

    @property
    def may_be_of_wood(self) -> bool:
        """Whether the densities of the wood's patches may explain more than what was found of the detector's cells."""
        posterior = self.last[1]
        bare = posterior.without(self._is_found_on_detector)
        same = bare.sizes == posterior.sizes
        if same or self.of_patches or self.left_out or Adjustment.WOOD_DENSITY in self.without:
            return False
        gained = self.climb.weighed(posterior) - self.climb.weighed(bare)
        return gained < OF_A_PATCH * len(wood_patches(self.model.drawing))

    def _is_found_on_detector(self, one: Fitted) -> bool:
        declared = one in self.declared_places or not first_cells_of([one]).isdisjoint(self.known_modules)
        return is_on_detector(one) and not declared

    def is_likelier(self, other: "JointFitter") -> bool:
        """Return whether this fit is likelier than another at the last steps of both, for the larger variance."""
        variance = max(self.variance, other.variance)
        return self._likelihood(variance) > other._likelihood(variance)  # noqa: SLF001 - its own class

    def _likelihood(self, variance: float) -> float:
        """Return the logarithm of prior times marginal likelihood at the last step, with this variance of a sample."""
        _, posterior, change, *_ = self.last
        system, sizes = posterior.system, posterior.change() - change
        # The power of the residual where the columns of all groups are 0.
        power = system.power + float(sizes @ (system.score + posterior.zero))
        of_patches = 0.0 if system.patches is None else system.patches.log_shrinkage
        return replace(posterior, variance=variance).log_likelihood - 0.5 * (power / variance - of_patches)

    @property
    def _within_drawing(self) -> bool:
        """Whether the precision of the drawing leaves all that is structured at the last step."""
        system = self.last[0]
        return system.structured <= system.source.of_drawing

    @property
    def _screening_step(self) -> int:
        return max(len(self.model.data.angles_rad) // SCREENED_VIEWS, 1)

    def _screened(self, grams: ViewGrams, model: ScanModel) -> list[Column]:
        """Return the fit's columns in the views that are tested first, without the views' random effects."""
        fitted = (column.every(self._screening_step) for one in self.fitted for column in one.columns)
        return [*self._project_out(grams, model), *fitted]

    def widen(self, *, patches: bool = False) -> None:
        """Go on with the effects of wood, or with the densities of patches too."""
        if not self.of_wood:
            self.waiting += self._of_effects(OF_WOOD)
            self.of_wood = True
        self.of_patches = self.of_patches or patches
        self._start_again()

    def _start_again(self) -> None:
        self.rounds, self.ended, self.gone = 0, False, set[Fitted]()

    def go_over(self, on_step: OnStep, most: int) -> None:
        """Go on from a set of motions that is likelier than the fitted one, at most this often."""
        for _ in range(most):
            likelier = self._motion_sets().likelier
            if likelier is None:
                return
            self._adopt(likelier)
            here = self.model.data.cells.modules
            further = first_cells_of(self.fitted) - {module.first_cell for module in here}
            self.model = with_modules(self.model, (*here, *map(DetectorModule, sorted(further))))
            self.rounds, self.ended = 0, False
            self.fit(on_step)

    def _motion_sets(self) -> MotionSets:
        """Return the sets of motions at the last step, which are searched once for each step."""
        _, posterior, change, grams, _ = self.last
        if self.sets is None or self.sets.current.sizes is not posterior.sizes:
            climb = Climb(self.model, self.climb.structured)
            self.sets = MotionSets(
                FitPoint(climb, grams, posterior, self.groups, change, self.without, self._within_drawing)
            )
        return self.sets

    def round(self) -> bool:
        """Let the likeliest groups join or go, and take one step; return whether the fit has ended."""
        self.rounds += 1
        grams, free = self._linearised()
        system, tried, used = self._system(grams, free)
        if self._relocated_modules(grams, system, used):
            grams, free = self._linearised()
            system, tried, used = self._system(grams, free)
        before = list(self.fitted)
        sizes = np.zeros(len(system.columns))
        for one in (*before, *tried):
            sizes[one.places] = one.sizes
        posterior, groups = self._chosen(system, tried, len(free), sizes)
        change = posterior.change() - sizes
        self._adopt(posterior, tried)
        dropped = [one for one in before if one not in self.fitted]
        self.gone |= set(dropped) if self.rounds > EARLY else set()
        self.unneeded |= first_cells_of(dropped) - self.known_modules
        left = max(system.power - 2.0 * float(change @ system.score) + float(change @ system.normal @ change), 0.0)
        degrees = len(posterior.used) - float(posterior.precision @ np.diag(posterior.covariance))
        self.variance = left / max(system.samples - degrees, 1.0)
        penalised = posterior.penalised
        off = off_by(penalised, posterior.used, change)
        # Structure that the drawing's precision may leave, and rounding, count as noise of this variance does.
        drawn = self.climb.structured if system.structured <= system.source.of_drawing else 0.0
        uncertain = max(self.variance, drawn / ON_DETECTOR, self._rounding(system) / system.samples)
        small = max(float(change @ penalised.score) / len(posterior.used), off) <= MOVED * uncertain
        whole, of_all = system.with_patches(change)
        of_poses = 0.0 if self.poses is None else pose_change(grams, whole.columns, of_all)
        self.model, share = stepped(self.model, whole, of_all, grams, of_poses=of_poses)
        for one in {*before, *tried}:
            one.sizes = one.sizes + share * change[one.places]
        self.model = self._with_fitted_modules()
        self.last = penalised, posterior, change, grams, tried
        self.groups = groups
        self.converged = off <= MOVED * self.variance
        same = set(before) == set(self.fitted)
        more = self._further_modules(grams, penalised, posterior.used, first_cells_of(tried) if same else ())
        if not (same and self._dropped_places(tried)):
            more = self._further_places(grams, penalised, posterior) or more
        # Cells cannot follow an arc that bends away from the source: the fit would take the same step in each round.
        same = not self._dropped_impossible(filter(_is_place, before)) and same
        if share == 0.0:
            # What was found of the cells may leave no step that explains more.
            stuck = [one for one in self.fitted if self._is_found_on_detector(one)]
            self._drop(stuck)
            return not stuck
        if share < 1.0 or not small or not same or more:
            return False
        settled = self._settled(system, change, grams.weights)
        self.converged = settled and not self._moved_borders(grams, penalised, posterior.used)
        return self.converged

    def _chosen(
        self, system: System, tried: Sequence[Fitted], free: int, sizes: FloatArray
    ) -> tuple[Posterior, list[Group]]:
        """Return the posterior of the likeliest sizes, from those (n,) of the last round: the best change at a time."""
        groups = [Group.of(one, self.model) for one in (*self.fitted, *tried) if not one.declined]
        everything = [*range(free), *(place for group in groups for place in group.one.places)]
        remaining = system.remaining(everything)
        noise = max(remaining, self._rounding(system)) / max(system.samples - len(everything), 1.0)
        structured = max(system.structured - (system.power - remaining), self._least_structured(system))
        fitted = {group: self.size_of[group.one] for group in groups if group.one in self.size_of}
        posterior = Posterior(system, system.score + system.normal @ sizes, noise, list(range(free)), fitted)
        posterior.scatter.update({each: scatter_of(posterior.resized(each, 0.0), each) for each in fitted})
        self.climb = climb = Climb(self.model, structured)
        most = MOST_JOINING if self.rounds <= JOINING else 0
        # Waves in time would take up what other motions explain, and join as another set of motions (`go_over`).
        waits = self.gone | {one for one in tried if one.effect in UNSTEADY_MOTIONS}
        out = [group for group in groups if group.one in waits]
        best = climb.to(posterior, groups, most, out)
        # What is found first replaces others: modules, an arc and waves are each tried first.
        of_cells = [group for group in groups if is_on_detector(group.one)]
        modules = [group for group in of_cells if is_module(group.one)]
        starts = [modules, *([group] for group in of_cells if group not in modules)]
        bare = posterior.without(is_motion).without(is_on_detector)
        for some in starts if most else ():
            if all(group in best.sizes for group in some):
                continue
            other = climb.to(bare, some, len(some))
            other = climb.to(other, groups, most, out) if set(other.sizes) != set(bare.sizes) else other
            # As many groups may join both, before they are compared.
            if climb.weighed(other) > climb.weighed(climb.to(best, groups, len(of_cells), out)):
                best = other
        return best, groups

    def _adopt(self, posterior: Posterior, tried: Sequence[Fitted] = ()) -> None:
        """Take the groups of a posterior as those that are fitted; one that leaves waits."""
        self.size_of = {group.one: size for group, size in posterior.sizes.items()}
        now = [group.one for group in posterior.sizes]
        kept, dropped = ([one for one in self.fitted if (one in now) is fitted] for fitted in (True, False))
        changed = [one for one in (*now, *dropped) if one not in kept and _is_slip(one)]
        # The other effect of a slip's view stays among those that may join.
        others = [one for one in tried if _is_slip(one)] if changed else []
        self.fitted = [*kept, *(one for one in now if one not in kept)]
        waiting = [one for one in dict.fromkeys([*self.waiting, *others, *dropped]) if one not in self.fitted]
        self.waiting = [one for one in waiting if first_cells_of([one]) <= self.known_modules]

    def result(self) -> JointFit:
        """Return the end point of the fit; what is not possible there leaves where the rounds ended before."""
        self._dropped_impossible(self.fitted)
        system, posterior, change, grams, tried = self.last
        return JointFit(
            self._with_fitted_modules(),
            tuple(self.fitted),
            system,
            posterior.used,
            posterior.precision * posterior.variance,
            change,
            self.variance,
            tuple(_shown_but_declined(system, posterior.used, tried, self.without)),
            self._motion_sets(),
            self.angle_variance,
            self.variation if self.variation is not None and _varies(self.variation) else None,
            tuple(self._hidden_modules(grams, system, posterior.used)),
            poses=self.poses,
            converged=self.converged,
            rounds=self.rounds,
        )

    def _linearised(self) -> tuple[ViewGrams, list[Column]]:
        """Compute the derivatives' inner products, without views' random effects, and the columns always fitted."""
        places = [one for one in (*self.fitted, *self.waiting) if _is_place(one)]
        of_cells = tuple(dict.fromkeys(chain.from_iterable(map(_terms, places))))
        # A model that stays the same keeps what it has computed.
        self.model = self.model if of_cells == self.model.of_cells else replace(self.model, of_cells=of_cells)
        grams = ViewGrams(self.model, of_wood=self.of_wood, of_patches=self.of_patches)
        if not self.model.view_gain and Adjustment.VIEW_GAIN not in self.without and views_differ(grams):
            self.model = self.model.with_view_gains(grams.weights)
            grams = ViewGrams(self.model, of_wood=self.of_wood, of_patches=self.of_patches)
        self.correlation = grams.correlation
        if self.left_out:
            fitted = [column for one in self.fitted for column in one.columns]
            self.poses, self.variance = likeliest_sizes(self.model, grams, [*self.base, *fitted])
        return grams, self._project_out(grams, self.model)

    def _project_out(self, grams: ViewGrams, model: ScanModel) -> list[Column]:
        """Project out the views' random effects, and return the columns always fitted."""
        if self.poses is not None:
            project_out_poses(model, grams, self.poses, self.variance)
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
        """Return equations of all columns, effects that may join (the likeliest slip too), and the fitted columns."""
        tried = list(self.waiting)
        base = [*free, *(column for one in self.fitted for column in one.columns)]
        if self.of_patches:
            self.variation = grams.vary_densities(base)
        more = not self.left_out and sum(map(_is_slip, self.fitted)) < MOST_SLIPS
        view = likeliest_slip(base, *grams.of_columns(base)) if more else None
        if view is not None:
            effects = (slip_at(view), jump_at(view))
            trials, declined = float(len(grams.scores)), Adjustment.SLIP in self.without
            tried += [Fitted(effect, effect.columns(self.model), trials, view, declined=declined) for effect in effects]
        system = grams.system([*base, *(column for one in tried for column in one.columns)])
        first = len(free)
        for one in (*self.fitted, *tried):
            one.places = list(range(first, first := first + len(one.columns)))
        return system, tried, list(range(len(base)))

    def _of_module(self, module: DetectorModule, trials: float) -> Fitted:
        effect = effect_of(module)
        return Fitted(effect, effect.columns(self.model), trials, declined=Adjustment.MODULES in self.without)

    def _with_fitted_modules(self) -> ScanModel:
        """Return the model with the known modules and those that are fitted."""
        kept = self.known_modules | first_cells_of(self.fitted)
        return with_modules(self.model, (one for one in self.model.data.cells.modules if one.first_cell in kept))

    @property
    def found_modules(self) -> list[tuple[Fitted, DetectorModule]]:
        """The effects of the modules that were found, each with its module."""
        modules = {one.first_cell: one for one in self.model.data.cells.modules}
        found = ((one, cell) for one in self.fitted for cell in first_cells_of([one]) - self.known_modules)
        return [(one, modules[cell]) for one, cell in found]

    def _module_search(self, grams: ViewGrams, system: System, used: list[int]) -> ModuleSearch:
        """Return the search next to these columns, which is made once for the derivatives of a round."""
        if self.searched is None or self.searched[0] is not grams or self.searched[1] != used:
            self.searched = grams, list(used), ModuleSearch(self.model, grams, system, used, self.unneeded)
        return self.searched[2]

    def _further_modules(self, grams: ViewGrams, system: System, used: list[int], tried: Collection[int]) -> bool:
        """Let the likeliest further modules join in the next round; return whether one is not near those just tried."""
        cells = self.model.data.cells
        most = MOST_MODULES - len(cells.modules)
        few = len(self.model.data.angles_rad) < FEWEST_VIEWS
        if few or Adjustment.MODULES in self.without or self.rounds >= JOINING or most <= 0:
            return False
        search = self._module_search(grams, system, used)
        modules = [DetectorModule(cell) for cell in search.likeliest(self._module_by_chance(system, used), most)]
        if all(any(abs(module.first_cell - cell) <= NEAR for cell in tried) for module in modules):
            return False
        self.model = with_modules(self.model, (*cells.modules, *modules))
        self.waiting += [self._of_module(module, MODULE_TRIALS * self._places_of_modules) for module in modules]
        return True

    def _further_places(self, grams: ViewGrams, system: System, posterior: Posterior) -> bool:
        """Let an arc and waves of the cells join in the next round, where they are likely; return whether any may."""
        few = len(self.model.data.angles_rad) < FEWEST_VIEWS or self.rounds >= JOINING
        if few or not self.without.isdisjoint((Adjustment.MODULES, Adjustment.CELL_PLACES)):
            return False
        further, likely = [], False
        for one in self._places_of_cells():
            terms = _terms(one)
            if set(terms) <= set(self.model.of_cells):
                continue
            further.append(one)
            search, group = self._module_search(grams, system, posterior.used), Group.of(one, self.model)
            information, score = search.left_of(self.model.rows_of_cells(terms) * group.unit[:, None])
            variance = max(posterior.variance, self.climb.structured / group.shares)
            evidence = group.evidence(information / variance, score / variance)
            precision = variance / group.sizes[int(evidence.argmax())] ** 2
            sizes = np.linalg.solve(information + precision * np.eye(len(score)), score)
            likely = likely or (
                evidence.max() > 0.0
                and float(sizes @ score) > self._rounding(system)
                and is_beyond_drawing(self.model, sizes * group.unit @ self.model.rows_of_cells(terms))
            )
        # Where one is likely, each is looked at.
        self.waiting += further if likely else ()
        return likely

    def _dropped_places(self, tried: Sequence[Fitted]) -> bool:
        """Drop an arc and waves that were tried and have not joined; return whether there were any."""
        kept = [*self.fitted, *self.declared_places]
        out = [one for one in tried if _is_place(one) and one not in kept]
        self.waiting = [one for one in self.waiting if one not in out]
        return bool(out)

    def _places_of_cells(self) -> list[Fitted]:
        return self._of_effects(tuple(places_of_cells(self.prepared_cells)))

    @property
    def _places_of_modules(self) -> float:
        """Number of places at which a module may begin: borders that are less than a module apart count as one."""
        return self.model.data.cells.count / FEWEST_CELLS

    def _module_by_chance(self, system: System, used: list[int]) -> float:
        """Return the power that a gap or a kink explains by chance, or by rounding errors, at its likeliest place."""
        variance = self._variance_on_detector(system, used)
        return max(variance * chance_limit(BEYOND_CHANCE / self._places_of_modules, 1), self._rounding(system))

    def _least_structured(self, system: System) -> float:
        """Return what is structured at least, whatever is fitted: the drawing is off by its precision."""
        return max(
            UNTRUSTED * system.structured, STRUCTURES / OF_DRAWING * min(system.structured, system.source.of_drawing)
        )

    def _variance_on_detector(self, system: System, used: list[int]) -> float:
        """Return the variance against which modules are judged: of noise, or their share of the structure."""
        return max(system.variance(used), self._least_structured(system) / ON_DETECTOR)

    def _rounding(self, system: System) -> float:
        """Return the power of a residual that rounding errors make in a scan without noise."""
        return system.samples * (ROUNDING * float(self.model.data.sinogram.std())) ** 2

    def _hidden_modules(self, grams: ViewGrams, system: System, used: list[int]) -> Iterator[tuple[HiddenModule, ...]]:
        """Yield the modules that the scan may hide, and for each that it shows the places at which it may begin."""
        if Adjustment.MODULES in self.without:
            return
        variance = self._variance_on_detector(system, used)
        if variance <= 0.0:
            return
        search, found = self._module_search(grams, system, used), [module for _, module in self.found_modules]
        hidden = tuple(search.hidden(variance))
        yield hidden
        # A detector that shows none hides further ones as far as the first does not take the evidence: the wood's
        # structure looks like one.
        left = 1.0 if found else 1.0 - sum(float(one.probabilities.sum()) for one in hidden) ** 2
        most = FURTHER_THAN_FOUND if found else FURTHER_HIDDEN
        for _ in range(most if len(found) < FURTHER_THAN_FOUND else 0):
            yield tuple(replace(one, probabilities=left * one.probabilities) for one in hidden)
        for module in sorted(found, key=lambda one: one.first_cell):
            places = self._places_of(module, grams, system, used)
            yield places.likely(variance) if places else tuple(search.elsewhere(module, variance))

    def _places_of(self, module: DetectorModule, grams: ViewGrams, system: System, used: list[int]) -> ModulePlaces:
        """Return where a found module may begin, each with the residual that the whole model leaves there."""
        if self.placed[0] is not self.model:
            self.placed = self.model, {}
        if module in self.placed[1]:
            return self.placed[1][module]
        search, variance = self._module_search(grams, system, used), self._variance_on_detector(system, used)
        nothing = system.with_patches(np.zeros(len(system.columns)))[1]
        others = [each for each in self.model.data.cells.modules if each.first_cell != module.first_cell]
        places = ModulePlaces()
        for one in search.places(module, variance):
            if any(abs(each.first_cell - one.first_cell) < FEWEST_CELLS for each in others):
                continue
            change = np.zeros(len(system.columns))
            change[used] = one.bias
            of_all, change = system.with_patches(change)
            then = moved(self.model, of_all.columns, change - nothing)
            then = with_modules(then, (*others, DetectorModule(one.first_cell, one.gap_mm, one.kink_rad)))
            if then.view_gain and then.clears:
                then = then.with_view_gains(grams.weights)
            if then.clears:
                places.add(one, then, grams.objective(then.residual))
        self.placed[1][module] = places
        return places

    def _relocated_modules(self, grams: ViewGrams, system: System, used: list[int]) -> bool:
        """Move a found module to where it explains more next to all that joined later; return whether one has moved."""
        if not self.found_modules or self.rounds > JOINING:
            return False
        search, by_chance = self._module_search(grams, system, used), self._module_by_chance(system, used)
        for one, module in self.found_modules:
            better = search.relocated(module, by_chance)
            if better != module.first_cell:
                others = [other for other in self.model.data.cells.modules if other.first_cell != module.first_cell]
                there = replace(module, first_cell=better)
                self._move(one, with_modules(self.model, (*others, there)), there)
                return True
        return False

    def _move(self, one: Fitted, model: ScanModel, module: DetectorModule) -> None:
        """Go over to a model in which a found module is this one."""
        self.model = model
        again = self._of_module(DetectorModule(module.first_cell), one.trials)
        again.sizes = np.array([module.gap_mm, module.kink_rad])
        self.fitted[self.fitted.index(one)] = again
        self.size_of[again] = self.size_of.pop(one)

    def _moved_borders(self, grams: ViewGrams, system: System, used: list[int]) -> bool:
        """Move the border of a found module to the likeliest place, if it has never been there.

        Return whether one has moved.
        """
        if self.rounds >= ROUNDS:
            return False
        for one, module in self.found_modules:
            self.begun.add(module.first_cell)
            places = self._places_of(module, grams, system, used)
            if places and (best := places.best)[0].first_cell not in self.begun:
                found, model, _ = best
                self._move(one, model, DetectorModule(found.first_cell, found.gap_mm, found.kink_rad))
                return True
        return False

    def _settled(self, system: System, change: FloatArray, weights: FloatArray) -> bool:
        """Return whether effects are possible, all scatter is fitted, averaging follows; else change the model."""
        if self._dropped_impossible(self.fitted):
            return False
        if self.angle_variance == 0.0 and Adjustment.ANGLE_JITTER not in self.without:
            self.angle_variance = angle_scatter(system, change, self.variance)
            if self.angle_variance > 0.0:
                return False
        if self.averaging is None or not (self.fitted or self.left_out):
            return True
        then, averaging = _with_new_averaging(self.model, self.averaging)
        # What the averaging changes may be within the noise.
        if float((weights * (averaging - self.averaging) ** 2).sum()) <= self.variance:
            return True
        self.model, self.averaging = then, None
        return False

    def _dropped_impossible(self, effects: Iterable[Fitted]) -> bool:
        """Drop the effects among these that are fitted and not possible; return whether there were any."""
        impossible = [one for one in effects if one in self.fitted and not one.effect.possible(self.model, one.sizes)]
        self._drop(impossible)
        return bool(impossible)

    def _drop(self, effects: Sequence[Fitted]) -> None:
        """Take effects out of the fit and the model for good."""
        for one in effects:
            self.model = moved(self.model, one.columns, -one.sizes)
            self.fitted.remove(one)
            self.size_of.pop(one)
            if not is_module(one):
                self.waiting.append(Fitted(one.effect, one.columns, one.trials, declined=True))
        out = first_cells_of(effects)
        self.unneeded |= out
        self.model = with_modules(
            self.model, (one for one in self.model.data.cells.modules if one.first_cell not in out)
        )


def _shown_but_declined(
    system: System, used: list[int], tried: Sequence[Fitted], without: Collection[Adjustment]
) -> Iterator[tuple[Fitted, EffectTest]]:
    """Yield the effects that the scan shows, and that the user switched off."""
    tester = EffectTester(system, used)
    for one in tried:
        if one.effect.adjustment in without and (
            (test := tester.tested(one.places)).is_beyond_chance(FITTED / one.trials)
        ):
            yield one, test


def _varies(variation: Variation) -> bool:
    return variation.likelihood > chance_limit(FITTED, 1)


def _is_place(one: Fitted) -> bool:
    return one.effect.adjustment is Adjustment.CELL_PLACES


def _terms(one: Fitted) -> list[int]:
    return [term for column in one.columns for term, _ in column.parts]


def _is_slip(one: Fitted) -> bool:
    return one.effect.adjustment is Adjustment.SLIP


def _with_new_averaging(model: ScanModel, before: FloatArray) -> tuple[ScanModel, FloatArray]:
    """Compute the averaging of intensities for the current model, and put it into the sinogram instead of `before`."""
    data = model.data
    position = model.pose[:, 1:] + model.x[[FitParameter.T_X, FitParameter.T_Y]]
    turned = replace(data, angles_rad=data.angles_rad + model.pose[:, 0])
    added = averaging(
        model.phantom, turned, model.frame, position_mm=position, gain=model.gain, turns=model.turns_while_exposed
    )
    return replace(model, data=replace(data, sinogram=data.sinogram - before + added)), added
