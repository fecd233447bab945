"""Angles that are ahead and behind once or twice a turn, as of an encoder off its axis."""

import math

import numpy as np

from sawmill_tomography.calibration.faults.effect import Effect
from sawmill_tomography.calibration.faults.motion import harmonics, of_angle
from sawmill_tomography.calibration.normal_equations import Column
from sawmill_tomography.calibration.scan_model import ScanModel
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _columns(model: ScanModel) -> tuple[Column, ...]:
    return of_angle([*harmonics(model, 1), *harmonics(model, 2)])


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    once, twice = np.rad2deg([math.hypot(*sizes[:2]), math.hypot(*sizes[2:])])
    return f"the angles are ahead and behind once a turn, by {once:.2g} degrees, and twice a turn, by {twice:.2g}"


ENCODER = Effect(
    Adjustment.ENCODER, _columns, _sentence, "the encoder is off its axis, or the drive slips and catches: look at them"
)
