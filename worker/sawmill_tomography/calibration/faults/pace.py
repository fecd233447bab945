"""Angles that run too fast or too slowly."""

from sawmill_tomography.calibration.faults.effect import Effect
from sawmill_tomography.calibration.faults.motion import of_angle, progress
from sawmill_tomography.calibration.normal_equations import Column
from sawmill_tomography.calibration.scan_model import ScanModel
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _columns(model: ScanModel) -> tuple[Column, ...]:
    return of_angle([progress(model)])


def _sentence(model: ScanModel, sizes: FloatArray) -> str:
    turned = float(model.data.angles_rad[-1] - model.data.angles_rad[0])
    pace = 1.0 + float(sizes[0]) / turned if turned else 1.0
    return f"the turntable turns {pace:.4f} times as far as the angles say"


PACE = Effect(
    Adjustment.PACE, _columns, _sentence, "check the angles' step, the encoder's counts in a turn, and the clamps"
)
