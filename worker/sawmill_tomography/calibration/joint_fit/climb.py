"""The climb from a set of groups to the likeliest one next to it, one group or size at a time."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.joint_fit.groups import (
    SIZES,
    STRUCTURES,
    Fitted,
    Group,
    Posterior,
    is_module,
    log_evidence,
)
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel
from sawmill_tomography.calibration.joint_fit.selection import EffectTester
from sawmill_tomography.calibration.joint_fit.slip import fewest
from sawmill_tomography.geometry.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Climb:
    """What decides between sets of groups at one point of the fit: the largest of noise, scatter and structure."""

    model: ScanModel
    structured: float  # the part of the residual's power that neighbouring cells share
    scatter: dict[Fitted, float]  # how much more than noise the scores of effects scatter from view to view
    _alike: dict[tuple[Group, ...], list["_Alike"]] = field(default_factory=dict, init=False)

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
            self.scatter[group.one] = scatter_of(posterior, group)
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
        if (every := tuple(groups)) not in self._alike:
            self._alike[every] = [_Alike.of(every, width) for width in {len(group.unit) for group in every}]
        found, (information, score) = np.empty((len(every), SIZES)), posterior.left_of_all
        for some in self._alike[every]:
            scatter = np.array([self.scatter.get(group.one, 1.0) for group in some.groups])
            tempered = posterior.variance / np.maximum(posterior.variance * scatter, self.structured / some.shares)
            places, unit = some.places, some.unit
            within = information[places[:, :, None], places[:, None]] * unit[:, :, None] * unit[:, None]
            own = tempered[:, None] * score[places] * unit
            found[some.numbers] = log_evidence(tempered[:, None, None] * within, own, some.sizes, some.log_odds)
        return found

    def evidence(self, posterior: Posterior, group: Group) -> FloatArray:
        """Return a group's evidence against the largest of three variances."""
        variance = max(posterior.variance * self.scatter.get(group.one, 1.0), self.structured / group.shares)
        information, score = posterior.left(group)
        tempered = posterior.variance / variance
        return group.evidence(tempered * information, tempered * score)


@dataclass(frozen=True, eq=False)
class _Alike:
    """Groups of one number of columns, w, one after another (g,)."""

    groups: list[Group]
    numbers: list[int]  # among all groups
    places: NDArray[np.intp]  # (g, w)
    unit: FloatArray  # (g, w)
    sizes: FloatArray  # (g, SIZES)
    log_odds: FloatArray  # (g, 1): of any size
    shares: FloatArray  # (g,)

    @classmethod
    def of(cls, every: Sequence[Group], width: int) -> "_Alike":
        """Return those of some groups that have this number of columns."""
        numbers = [number for number, group in enumerate(every) if len(group.unit) == width]
        groups = [every[number] for number in numbers]
        return cls(
            groups,
            numbers,
            np.array([group.one.places for group in groups]),
            np.stack([group.unit for group in groups]),
            np.stack([group.sizes for group in groups]),
            np.array([[group.log_odds] for group in groups]),
            np.array([group.shares for group in groups]),
        )


def scatter_of(posterior: Posterior, group: Group) -> float:
    """Return how much more than noise a group's score scatters from view to view."""
    here, one = replace(posterior.system, structured=0.0), group.one
    system = here.without(one.places, one.sizes) if one.sizes.any() else here
    test = EffectTester(system, posterior.used).tested(group.one.places)
    plain = system.variance([*posterior.used, *group.one.places])
    return max(test.variance / plain, 1.0) if plain > 0.0 else 1.0
