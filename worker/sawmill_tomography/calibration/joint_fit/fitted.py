"""Effects that are fitted or tested next to a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sawmill_tomography.calibration.faults.effects import Effect
from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, first_cell, is_of_module
from sawmill_tomography.calibration.joint_fit.selection import EffectTest
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
