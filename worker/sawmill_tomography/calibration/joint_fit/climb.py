"""The climb from a set of groups to the likeliest one next to it, one group or size at a time."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sawmill_tomography.calibration.joint_fit.groups import (
    STRUCTURES,
    Group,
    GroupColumns,
    Posterior,
    is_module,
)
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel
from sawmill_tomography.calibration.joint_fit.selection import EffectTester
from sawmill_tomography.calibration.joint_fit.slip import fewest
from sawmill_tomography.effect_priors import SIZES
from sawmill_tomography.geometry.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Climb:
    """What decides between sets of groups at one point of the fit: the largest of noise, scatter and structure."""

    model: ScanModel
    structured: float  # the part of the residual's power that neighbouring cells share
    _columns: dict[tuple[Group, ...], GroupColumns] = field(default_factory=dict, init=False)

    def to(self, posterior: Posterior, groups: Sequence[Group], most: int, barred: Collection[Group] = ()) -> Posterior:
        """Return the posterior after the best changes of one size at a time; at most `most` groups join."""
        out, been = set(barred), set[frozenset[object]]()
        # Each group has a variance of its own: a climb may come back to where it was, and ends there.
        while (here := frozenset([*posterior.sizes.items(), *out])) not in been:
            been.add(here)
            changes: list[tuple[float, Group | None, float]] = [(0.0, None, 0.0)]
            likeliest = self.evidences(posterior, groups).max(axis=1).tolist() if most else []
            for each, gained in zip(groups, likeliest, strict=False):
                if gained > 0.0 and each not in out and self.may_join(each, posterior):
                    changes.append((gained, each, 0.0))
            for each, now in posterior.sizes.items():
                evidence = self.evidence(posterior, each)
                current, place = each.at(evidence, now), int(evidence.argmax())
                changes.append((float(evidence[place]) - current, each, float(each.sizes[place])))
                changes.append((-current, each, 0.0))
            gained, group, size = max(changes, key=lambda change: change[0])
            if group is None:
                break
            if group in posterior.sizes:
                posterior = posterior.resized(group, size)
                if not size:
                    out.add(group)
                continue
            posterior.scatter[group] = scatter_of(posterior, group)
            evidence = self.evidence(posterior, group)
            then = posterior.resized(group, float(group.sizes[int(evidence.argmax())]))
            own = [then.used.index(place) for place in group.one.places]
            # The gap and kink of one of several modules are often not possible before the others have joined.
            may = is_module(group.one) or group.one.effect.possible(self.model, then.mean[own])
            if evidence.max() > 0.0 and may:
                posterior, most = then, most - 1
            else:
                out.add(group)
        return posterior

    @staticmethod
    def may_join(group: Group, posterior: Posterior) -> bool:
        """Return whether a group is not in a set, and no slip of its kind that is too near is."""
        views, view = posterior.system.views, group.one.view
        return group not in posterior.sizes and (
            view is None
            or all(
                each.one.view is None or len(each.unit) != len(group.unit) or abs(each.one.view - view) >= fewest(views)
                for each in posterior.sizes
            )
        )

    def weighed(self, posterior: Posterior) -> float:
        """Return the likelihood (logarithm) by which sets of groups are compared, with one variance for all."""
        return replace(posterior, variance=max(posterior.variance, self.structured / STRUCTURES)).log_likelihood

    def evidences(self, posterior: Posterior, groups: Sequence[Group]) -> FloatArray:
        """Return the evidence (groups, SIZES) of groups that are not fitted, as `evidence` does."""
        if (every := tuple(groups)) not in self._columns:
            self._columns[every] = GroupColumns.of(every)
        scatter = np.array([posterior.scatter.get(group, 1.0) for group in every])
        columns = self._columns[every]
        tempered = posterior.variance / np.maximum(posterior.variance * scatter, self.structured / columns.shares)
        return columns.evidences(*posterior.left_of_all, tempered)

    def scattered(self, posterior: Posterior, groups: Sequence[Group]) -> FloatArray:
        """Return the evidence of `evidences`, with the scatter of groups whose sizes together are as likely as none."""
        evidences = self.evidences(posterior, groups)
        for number, group in enumerate(groups):
            if evidences[number].max() > -math.log(SIZES) and group not in posterior.sizes | posterior.scatter:
                posterior.scatter[group] = scatter_of(posterior, group)
                evidences[number] = self.evidence(posterior, group)
        return evidences

    def evidence(self, posterior: Posterior, group: Group) -> FloatArray:
        """Return a group's evidence against the largest of three variances."""
        variance = max(posterior.variance * posterior.scatter.get(group, 1.0), self.structured / group.shares)
        information, score = posterior.left(group)
        tempered = posterior.variance / variance
        return group.evidence(tempered * information, tempered * score)


def scatter_of(posterior: Posterior, group: Group) -> float:
    """Return how much more than noise a group's score scatters from view to view."""
    here, one = replace(posterior.system, structured=0.0), group.one
    system = here.without(one.places, one.sizes) if one.sizes.any() else here
    test = EffectTester(system, posterior.used).tested(group.one.places)
    plain = system.variance([*posterior.used, *group.one.places])
    return max(test.variance / plain, 1.0) if plain > 0.0 else 1.0
