"""Sets of motions that explain a scan, each with its probability: one scan alone rarely shows what moves.

The sets are searched from several starts, since each end of a climb stands for others that explain almost as much. The
ray error's bound counts all of them, and in each the groups and sizes that are not the likeliest.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.covariance import pseudo_inverse
from sawmill_tomography.calibration.joint_fit.climb import Climb
from sawmill_tomography.calibration.joint_fit.effects import DEFORMATION, WAVES, Effect
from sawmill_tomography.calibration.joint_fit.groups import (
    STRUCTURES,
    Fitted,
    Group,
    Posterior,
    is_module,
    is_motion,
    is_on_detector,
)
from sawmill_tomography.calibration.joint_fit.normal_equations import ViewGrams
from sawmill_tomography.calibration.joint_fit.slip import fewest, jump_at, likeliest_slip, places_of_slips, slip_at
from sawmill_tomography.effect_priors import SIZES
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.geometry.ray_error import DRAWS
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.messages import Reason

MOST_SLIPS = 3
# Where something moves, the bound counts any other motion as likelier by this factor: what is loose moves again
# (benchmarks/families.py).
UNSTEADY = 3.0
# Motions of which one kind is looked at first, and their numbers of columns: slips of the phantom, jumps of the
# scanner, motions from the first view to the last, motions of any shape, and motions that turn with the table.
STARTS = (
    ({Adjustment.SLIP}, {3}),
    ({Adjustment.SLIP}, {2}),
    ({Adjustment.CREEP, Adjustment.PACE}, {1, 2}),
    ({Adjustment.CREEP}, {*range(4, 2 * WAVES + 1)}),
    ({Adjustment.WOBBLE, Adjustment.ENCODER}, {4}),
)


@dataclass(frozen=True, eq=False)
class FitPoint:
    """The last step of a fit: what sets of motions are searched next to."""

    climb: Climb
    grams: ViewGrams
    posterior: Posterior
    groups: Sequence[Group]
    change: FloatArray  # the last step, (n,)
    without: Collection[Adjustment]
    within_drawing: bool  # the precision of the drawing leaves all that is structured


def _moving(posterior: Posterior) -> set[Group]:
    return {group for group in posterior.sizes if is_motion(group.one)}


class MotionSets:
    """The sets of motions that a scan may show, at one point of the fit."""

    def __init__(self, point: FitPoint) -> None:
        self._point, self._climb = point, point.climb
        self._placed: list[Group] = []
        self._are_suspected = self._suspected()
        self.current = self._with_places()

    @property
    def likelier(self) -> Posterior | None:
        """A set that is likelier than the fitted one, if there is one."""
        weighed = self._climb.weighed
        best = max(self._explored, key=weighed)
        # The fit itself lets all that does not move join or go.
        same = _moving(best) == _moving(self.current)
        return None if same or weighed(best) <= weighed(self.current) else best

    @cached_property
    def likely(self) -> list[tuple[Posterior, float]]:
        """The likely sets with their probabilities, the set that is fitted first."""
        own = set(self.current.sizes)
        sets = [self.current, *(each for each in self._explored if set(each.sizes) != own)]
        weights = np.array([self._climb.weighed(each) for each in sets])
        weights = np.exp(weights - weights.max())
        weights /= weights.sum()
        kept = [n for n, weight in enumerate(weights) if n == 0 or DRAWS * weight > 1.0]
        return [(sets[n], float(weights[n] / weights[kept].sum())) for n in kept]

    def instead_of(self, one: Fitted) -> list[Reason]:
        """Return what may be real instead of a fitted effect that is not likely enough; nothing if it is."""
        alike = {one.effect.adjustment} if one.effect.adjustment is Adjustment.SLIP else set()

        def has(posterior: Posterior) -> bool:
            effects = [group.one.effect for group in posterior.sizes]
            return one.effect in effects or any(effect.adjustment in alike for effect in effects)

        with_it = sum(probability for each, probability in self.likely if has(each))
        if with_it > 1.0 - with_it:
            return []
        fitted = {group.one.effect for group in self.current.sizes}
        likelier: dict[Effect, float] = {}
        reasons: dict[Effect, Reason] = {}
        for each, probability in self.likely:
            for group in each.sizes if not has(each) else ():
                effect = group.one.effect
                if effect not in fitted and not is_on_detector(group.one):
                    own = [each.used.index(place) for place in group.one.places]
                    likelier[effect] = likelier.get(effect, 0.0) + probability
                    reasons.setdefault(effect, effect.reason(self._climb.model, each.mean[own]))
        # The others that are as likely as it, and otherwise the likeliest.
        return [reasons[each] for each in likelier if likelier[each] >= min(with_it, max(likelier.values()))]

    def may_be(self, effect: Effect) -> bool:
        """Return whether an effect that is not fitted may be real instead of a fitted one."""
        others = [probability for each, probability in self.likely[1:] if effect in {g.one.effect for g in each.sizes}]
        return sum(others) > 1.0 - sum(others)

    @cached_property
    def _explored(self) -> list[Posterior]:
        """Sets of motions: from several starts, next to the best set, and with one motion replaced."""
        groups = [*self._point.groups, *self._placed]
        motions = [group for group in groups if is_motion(group.one)]
        current, climb = self.current, self._climb
        if not self._are_suspected:
            return [current]
        still = current.without(is_motion)
        found: dict[frozenset[Group], Posterior] = {}

        def explore(start: Posterior, barred: Collection[Group] = ()) -> None:
            end = climb.to(start, groups, len(groups), barred)
            found.setdefault(frozenset(end.sizes), end)

        explore(current)
        explore(still)
        for kinds, widths in STARTS:
            of_kind = [each for each in motions if each.one.effect.adjustment in kinds and len(each.unit) in widths]
            explore(climb.to(still, of_kind, len(groups)))
        # The best set is left by each of its groups in turn, until that finds no better one.
        best = None
        while (likeliest := max(found.values(), key=climb.weighed)) is not best:
            best = likeliest
            for group in [group for group in best.sizes if not is_on_detector(group.one)]:
                explore(best.resized(group, 0.0), [group])
        # Another motion may stand in the place of each; one that is less likely by this factor moves no bound.
        for rest in [best.resized(group, 0.0) for group in best.sizes if is_motion(group.one)]:
            least = climb.weighed(best) - climb.weighed(rest) - 0.5 * math.log(DRAWS)
            for other, evidence in zip(motions, climb.evidences(rest, motions), strict=True):
                if evidence.max() > least and climb.may_join(other, rest):
                    instead = rest.resized(other, float(other.sizes[int(evidence.argmax())]))
                    found.setdefault(frozenset(instead.sizes), instead)
        return list(found.values())

    def _suspected(self) -> bool:
        """Return whether something moves, or may: the likeliest slip and jump are among the groups."""
        here, climb = self._point.posterior, self._climb
        # What the phantom's outline shows may be a motion.
        if any(is_motion(group.one) or group.one.effect is DEFORMATION for group in here.sizes):
            return True
        if self._point.within_drawing:
            return False
        if climb.structured / STRUCTURES > here.variance:
            return True
        motions = [group for group in self._point.groups if is_motion(group.one)]
        return bool((climb.scattered(here, motions) > -math.log(SIZES)).any())

    def _with_places(self) -> Posterior:
        """Return the last posterior next to slips at some views."""
        point, last = self._point, self._point.posterior
        columns, count = list(last.system.columns), len(point.grams.scores)
        slips = [group.one for group in point.groups if group.one.effect.adjustment is Adjustment.SLIP]
        views = places_of_slips(count) if Adjustment.SLIP not in point.without else []
        model = self._climb.model
        known = {one.view for one in slips if one.view is not None}
        # Slips nearer to each other than this are one, which may be at any view between.
        apart = range(1, fewest(count) + 1)
        near = {view + way * by for view in known for by in apart for way in (-1, 1) if 0 < view + way * by < count}
        near |= {*self._pursued()} if self._are_suspected else set()
        for view in sorted({*views, *near}) if views else ():
            for effect in (slip_at(view), jump_at(view)):
                one = Fitted(effect, effect.columns(model), float(len(views) if view in views else count), view)
                if any(one.view == other.view and len(one.columns) == len(other.columns) for other in slips):
                    continue
                one.places = list(range(len(columns), len(columns) + len(one.columns)))
                columns += one.columns
                self._placed.append(Group.of(one, model))
        system = point.grams.system(columns)
        # The groups' sizes at the point where the derivatives were taken.
        sizes = np.pad(last.change() - point.change, (0, len(columns) - len(point.change)))
        return replace(last, system=system, zero=system.score + system.normal @ sizes)

    def _pursued(self) -> list[int]:
        """Return the views of several slips that together explain most where nothing else moves."""
        point, columns = self._point, self._point.posterior.system.columns
        if Adjustment.SLIP in point.without:
            return []
        used = set(point.posterior.used)
        moving = [place for group in point.groups if is_motion(group.one) for place in group.one.places]
        at = np.zeros(len(columns))
        for group in point.groups:
            at[group.one.places] = group.one.sizes
        moved, kept = [place for place in moving if at[place]], sorted(used - set(moving))
        steps = [slip_at(view).columns(self._climb.model) for view in range(len(point.grams.scores))]
        views: list[int] = []

        def likeliest(others: Sequence[int]) -> int | None:
            some = [columns[place] for place in kept] + [column for view in others for column in steps[view]]
            left = np.eye(len(some) + len(moved), len(some))
            there = np.concatenate([np.zeros(len(some)), at[moved]])
            return likeliest_slip(some, *point.grams.of_columns([*some, *(columns[n] for n in moved)], left, there))

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

    @cached_property
    def errors(self) -> FloatArray | None:
        """Draw errors (n, used) of the fitted columns by what may be real instead; None where nothing may be.

        In each set of motions one group may have another size: one that is not fitted, or 0 where it is. Of `DRAWS`
        draws the remaining ones have no error.
        """
        rng = np.random.default_rng(0)
        (first, _), count = self.likely[0], len(self.likely[0][0].used)
        errors, real = np.zeros((DRAWS, count)), np.zeros(DRAWS, bool)
        of_set = np.searchsorted(np.cumsum([probability for _, probability in self.likely]), rng.random(DRAWS))
        for number, (posterior, _) in enumerate(self.likely):
            drawn = np.flatnonzero(of_set == number)
            if not drawn.size:
                continue
            own, there = np.zeros((drawn.size, len(posterior.used))), np.zeros(drawn.size, bool)
            groups = list(self._averaged(posterior))
            evidence = np.column_stack([np.zeros(len(groups)), self._evidence_of_others(posterior, groups)])
            weights = np.cumsum(np.exp(evidence - evidence.max(axis=1, keepdims=True)), axis=1)
            at = rng.random((len(groups), drawn.size)) * weights[:, -1:]
            for group, sums, which in zip(groups, weights, at, strict=True):
                here = np.flatnonzero(which >= sums[0])
                own[here] += self._errors_of(posterior, group, np.searchsorted(sums, which[here]) - 1, rng)
                there[here] = True
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
            errors[np.ix_(drawn, np.array(one))] += own + rng.standard_normal(own.shape) @ root.T
        return errors[real] if real.any() else None

    def _averaged(self, posterior: Posterior) -> Iterator[Group]:
        views = len(self._point.grams.scores)
        for group in self._point.groups:
            searched = is_module(group.one) or group.one.effect.adjustment is Adjustment.SLIP
            if group in posterior.sizes or not searched:
                yield group
        yield from (group for group in self._placed if group in posterior.sizes or group.one.trials < views)

    def _evidence_of_others(self, posterior: Posterior, groups: Sequence[Group]) -> FloatArray:
        """Return the evidence (groups, SIZES) of each other size of groups: of 0, the first, where one is fitted."""
        evidence = self._climb.scattered(posterior, groups)
        moves = any(is_motion(each.one) for each in posterior.sizes)
        for number, group in enumerate(groups):
            if group in posterior.sizes:
                evidence[number] = -np.inf
                evidence[number, 0] = -group.at(self._climb.evidence(posterior, group), posterior.sizes[group])
            elif moves and is_motion(group.one):
                evidence[number] += math.log(UNSTEADY)
        return evidence

    @staticmethod
    def _errors_of(
        posterior: Posterior, group: Group, others: NDArray[np.intp], rng: np.random.Generator
    ) -> FloatArray:
        """Draw errors (draws, used) of the fitted columns where a group has other sizes, of these numbers (draws,)."""
        if group in posterior.sizes:
            own = [posterior.used.index(place) for place in group.one.places]
            within = posterior.covariance[np.ix_(own, own)]
            bias = -posterior.covariance[:, own] @ pseudo_inverse(within, 1e-15) @ posterior.mean[own]
            return np.asarray(np.broadcast_to(bias, (others.size, bias.size)))
        information, score = posterior.left(group)
        values, vectors = np.linalg.eigh(information)
        variances = group.sizes[others, None] ** 2
        shrunk = variances / (1.0 + variances * np.maximum(values, 0.0))
        changes = np.sqrt(shrunk) * rng.standard_normal(shrunk.shape) - shrunk * (vectors.T @ score)
        return np.asarray(changes @ (posterior.sensitivity[:, group.one.places] * group.unit @ vectors).T)
