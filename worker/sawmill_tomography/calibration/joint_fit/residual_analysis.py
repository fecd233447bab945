"""The analysis of a scan beyond the plain model: effects, and structure in the residual."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.joint_fit.groups import MOTIONS
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.residual_statistics import ResidualStatistics
from sawmill_tomography.calibration.joint_fit.structure import Structure, find_structure
from sawmill_tomography.calibration.joint_fit.view_poses import PoseSizes
from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, Scanner
from sawmill_tomography.geometry.ray_error import ray_error_of_bias
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.scan_messages import AdjustmentMessage, EffectMessage

# Effects that are fitted where cells are elsewhere than the model has them.
FROM_VIEW_TO_VIEW = MOTIONS | {Adjustment.ANGLE_JITTER}
# Where something moved at two views or more, or unsteadily, other motions may explain the scan as well: the rays' error
# may be larger by this factor (test_unsteadiness.py).
MOVES_OFTEN = 2.0


@dataclass(frozen=True)
class FoundEffect:
    """An effect that is far beyond chance."""

    adjustment: Adjustment  # the option that switches the effect's fit off
    reason: Reason  # the effect and its size; the action is the remedy, empty where nothing need be done
    ray_error_mm: float  # RMS ray error that the effect causes where it is not fitted
    fitted: bool

    @property
    def scanner_moved_mm(self) -> float:
        """Creep or jump of source, turntable or detector, if the effect is one, or may be one; 0 for none."""
        values = dict(item for each in (self.reason, *self.reason.parts) for item in each.values.items())
        return max(float(values.get(name, 0.0)) for name in ("scanner_creep_mm", "jump_mm"))


@dataclass(frozen=True)
class ResidualAnalysis:
    """Effects found in the scan, and structure in the residual."""

    effects: tuple[FoundEffect, ...] = ()  # effects in the order in which they were found
    structure: Structure | None = None  # structure that is left in the residual; None where the residual is white noise
    poses: PoseSizes | None = None  # sizes of the views' poses; None where the object turns in one scan

    @property
    def cells_misplaced(self) -> bool:
        """True if cells are elsewhere than the model has them: motions that are fitted in place of that are none."""
        return self.structure is not None and bool(self.structure.cells)

    @property
    def adjustments(self) -> tuple[Reason, ...]:
        """Sentences on the effects that were fitted."""
        fitted = [effect for effect in self.effects if effect.fitted]
        named = [each for each in fitted if not (self.cells_misplaced and each.adjustment in FROM_VIEW_TO_VIEW)]
        stand_ins = len(fitted) - len(named)
        of_cells = (AdjustmentMessage.STAND_INS(effects=stand_ins),) if stand_ins else ()
        return (*of_cells, *(AdjustmentMessage.FITTED(each.reason) for each in named))

    @property
    def jumps(self) -> int:
        """Number of views at which the phantom or the scanner moved."""
        return sum(effect.fitted and effect.adjustment is Adjustment.SLIP for effect in self.effects)

    @property
    def bound_times(self) -> float:
        """Factor of the ray error's bound."""
        fitted = {code for effect in self.effects if effect.fitted for code in effect.reason.codes}
        unsteady = fitted & {EffectMessage.PHANTOM_UNSTEADY, EffectMessage.SCANNER_UNSTEADY}
        return MOVES_OFTEN if unsteady or self.jumps > 1 else 1.0

    @property
    def phantom_moved(self) -> bool:
        """True if the phantom slipped or crept during the scan."""
        return any(effect.adjustment in {Adjustment.SLIP, Adjustment.CREEP} for effect in self.effects)


def analyse_residual(
    joint: JointFit, statistics: ResidualStatistics, scanner: Scanner, radius_mm: float
) -> ResidualAnalysis:
    """Describe the effects in the scan, and the structure that the joint fit leaves."""
    effects = (*_fitted(joint, scanner, radius_mm), *_not_fitted(joint, scanner, radius_mm))
    model, structure = joint.model, None
    if statistics.structured:
        used = 1.0 if model.data.weights is None else model.data.weights > 0.0
        structure = find_structure(model.residual * used, model.prediction)
    return ResidualAnalysis(effects, structure, joint.poses)


def _fitted(joint: JointFit, scanner: Scanner, radius_mm: float) -> Iterator[FoundEffect]:
    if joint.model.view_gain:
        yield FoundEffect(Adjustment.VIEW_GAIN, EffectMessage.VIEW_GAIN(), 0.0, fitted=True)
    if joint.poses is not None:
        elsewhere = EffectMessage.VIEWS_ELSEWHERE(
            shift_mm=joint.poses.shift_mm, roll_deg=math.degrees(joint.poses.roll_rad)
        )
        yield FoundEffect(Adjustment.VIEW_POSES, elsewhere, 0.0, fitted=True)
    if joint.variation is not None:
        varies = EffectMessage.WOOD_DENSITY(deviation_percent=100.0 * joint.variation.deviation)
        yield FoundEffect(Adjustment.WOOD_DENSITY, varies, 0.0, fitted=True)
    if joint.angle_variance > 0.0:
        deviation = math.sqrt(joint.angle_variance)
        scattered = EffectMessage.ANGLE_JITTER(jitter_deg=math.degrees(deviation))
        yield FoundEffect(Adjustment.ANGLE_JITTER, scattered, deviation * joint.model.drawing.radius_mm, fitted=True)
    for one in joint.fitted:
        columns, off = joint.without(one)
        reasons = [one.effect.reason(joint.model, one.sizes), *joint.motion_sets.instead_of(one)]
        yield FoundEffect(
            one.effect.adjustment,
            reasons[0] if len(reasons) == 1 else EffectMessage.ONE_OF(*reasons),
            _off_mm(joint, columns, off, scanner, radius_mm),
            fitted=True,
        )


def _not_fitted(joint: JointFit, scanner: Scanner, radius_mm: float) -> Iterator[FoundEffect]:
    columns = [joint.system.columns[i] for i in joint.used]
    for one, test in joint.declined:
        off_mm = _off_mm(joint, columns, test.bias, scanner, radius_mm)
        yield FoundEffect(one.effect.adjustment, one.effect.reason(joint.model, test.sizes), off_mm, fitted=False)


def _off_mm(joint: JointFit, columns: Sequence[Column], off: FloatArray, scanner: Scanner, radius_mm: float) -> float:
    """Compute the RMS ray error of these errors of the columns."""
    bias = np.zeros(len(FitParameter))
    for column, moved in zip(columns, off, strict=True):
        if column.parameter is not None:
            bias[column.parameter] = moved
    return ray_error_of_bias(scanner, joint.model.frame, bias[FRAME], radius_mm=radius_mm)
