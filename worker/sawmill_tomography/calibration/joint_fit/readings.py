"""Effects that are fitted or tested beside a fit, and other readings of a scan that does not tell them apart."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sawmill_tomography.calibration.faults.effects import ALIKE, Effect
from sawmill_tomography.calibration.joint_fit.normal_equations import Column, System
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, first_cell, is_of_module
from sawmill_tomography.calibration.joint_fit.selection import STRUCTURES, EffectTest, EffectTester
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


@dataclass(eq=False)
class Fitted:
    """An effect that is fitted or tested."""

    effect: Effect
    columns: tuple[Column, ...]
    trials: float = 1.0  # number of places at which the effect was searched: the views, for a slip
    declined: bool = False  # the effect must not join the fit: other effects explained it, or the user switched it off
    sizes: FloatArray = field(init=False)  # (columns,): sizes of the effect's columns
    places: list[int] = field(init=False, default_factory=list)  # indices of the effect's columns in the current system

    def __post_init__(self) -> None:
        """Set all sizes to 0."""
        self.sizes = np.zeros(len(self.columns))

    def may_join(self, model: ScanModel, test: EffectTest) -> bool:
        """Return whether the effect may join the fit of a model with the sizes of a test."""
        return not self.declined and test.degrees > 0 and self.effect.possible(model, test.sizes)


def is_module(one: Fitted) -> bool:
    """Return whether an effect is the gap and kink of a module."""
    return one.effect.adjustment is Adjustment.MODULES


def first_cells_of(effects: Sequence[Fitted]) -> set[int]:
    """Return the first cells of the modules whose gaps and kinks are among the effects."""
    terms = [column.term for one in effects for column in one.columns]
    return {first_cell(term) for term in terms if term is not None and is_of_module(term)}


# Effects that move the phantom or the angles, of which a scan may not tell which is real, and the least likelihood of
# another against the fitted one's.
MOTIONS = frozenset({Adjustment.PACE, Adjustment.CREEP, Adjustment.SLIP, Adjustment.ENCODER, Adjustment.WOBBLE})
LEAST_WEIGHT = 0.01


@dataclass(frozen=True, eq=False)
class OtherReading:
    """An effect that explains the scan as well as a fitted effect, so that the scan does not show which is real."""

    fitted: Fitted
    other: Fitted
    sizes: FloatArray  # (columns,): sizes of the columns of `other`, if `other` were fitted instead of `fitted`
    bias: FloatArray  # (used,): change of all fitted columns in that case, 0 for those of `fitted`
    weight: float  # likelihood of the other effect, against the fitted one's


def other_reading(
    system: System, used: list[int], fitted: Sequence[Fitted], tried: Sequence[Fitted]
) -> OtherReading | None:
    """Find an effect that may be real instead of a fitted one: the second of `ALIKE`, if it leaves nothing to fit."""
    pair = [one for one in (*fitted, *tried) if one.effect in ALIKE]
    one = next((one for one in pair if one in fitted), None)
    other = next((one for one in pair if one not in fitted), None)
    if one is None or other is None:
        return None
    rest = [i for i in used if i not in one.places]
    without = system.without(one.places, one.sizes)
    if EffectTester(without, [*rest, *other.places]).tested(one.places).is_fitted():
        return None
    return _Instead(system, used, one).reading(other)


def other_motions(
    system: System, used: list[int], fitted: Sequence[Fitted], tried: Sequence[Fitted]
) -> Iterator[OtherReading]:
    """Yield the motions that may be real instead of a fitted motion: those that explain almost as much.

    What an effect explains is only as certain as the noise, and its share of what the residual has beside noise.
    """
    variance = max(system.variance(used), system.structured / STRUCTURES)
    for one in fitted:
        if one.effect.adjustment in MOTIONS:
            instead = _Instead(system, used, one)
            for other in tried:
                if other.effect.adjustment in MOTIONS and not other.declined:
                    reading = instead.reading(other, variance)
                    if reading.weight > LEAST_WEIGHT:
                        yield reading


class _Instead:
    """The comparison of other effects with a fitted one, which each replaces."""

    def __init__(self, system: System, used: list[int], one: Fitted) -> None:
        self._one, self._used = one, used
        self._rest = [i for i in used if i not in one.places]
        self._tester = EffectTester(system.without(one.places, one.sizes), self._rest)
        self._own = self._tester.tested(one.places)

    def reading(self, other: Fitted, variance: float | None = None) -> OtherReading:
        """Return the reading with the other effect; its weight is its likelihood, or 1 without a variance."""
        test = self._tester.tested(other.places)
        bias = np.zeros(len(self._used))
        bias[[n for n, place in enumerate(self._used) if place in self._rest]] = test.bias - self._own.bias
        weight = 1.0
        if variance is not None:
            # By chance an effect explains a variance for each unknown, and the best of many places more.
            chance = [
                test.degrees + 2.0 * math.log(one.trials) for one, test in ((self._one, self._own), (other, test))
            ]
            less = max(self._own.power - test.power - variance * (chance[0] - chance[1]), 0.0)
            weight = math.exp(-0.5 * less / variance) if variance > 0.0 else float(less == 0.0)
        return OtherReading(self._one, other, test.sizes, bias, weight)
