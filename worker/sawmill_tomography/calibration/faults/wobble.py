"""A turntable whose axis wobbles, once or twice a turn, as of a worn bearing."""

from collections.abc import Callable

from sawmill_tomography.calibration.faults.effect import Effect
from sawmill_tomography.calibration.faults.motion import harmonics, in_the_laboratory, largest_move
from sawmill_tomography.calibration.normal_equations import Column
from sawmill_tomography.calibration.scan_model import ScanModel
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

REMEDY = "look at the turntable's bearing and what the phantom stands on"


def _once(model: ScanModel) -> tuple[Column, ...]:
    return in_the_laboratory(model, harmonics(model, 1))


def _twice(model: ScanModel) -> tuple[Column, ...]:
    return in_the_laboratory(model, harmonics(model, 2))


def _sentence(times: str) -> Callable[[ScanModel, FloatArray], str]:
    def sentence(_: ScanModel, sizes: FloatArray) -> str:
        return f"the turntable wobbles {times} a turn, by {largest_move(sizes):.2g} mm"

    return sentence


WOBBLE_ONCE = Effect(Adjustment.WOBBLE, _once, _sentence("once"), REMEDY)
WOBBLE_TWICE = Effect(Adjustment.WOBBLE, _twice, _sentence("twice"), REMEDY)
