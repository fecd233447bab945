"""A phantom that moves steadily during the scan."""

import math

from sawmill_tomography.calibration.faults.effect import Effect
from sawmill_tomography.calibration.faults.motion import of_position, progress
from sawmill_tomography.calibration.normal_equations import Column
from sawmill_tomography.calibration.scan_model import ScanModel
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _columns(model: ScanModel) -> tuple[Column, ...]:
    return of_position([progress(model)])


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    return f"the phantom creeps by {math.hypot(*sizes):.2g} mm over the scan"


CREEP = Effect(Adjustment.CREEP, _columns, _sentence, "fasten the phantom on the turntable")
