"""The phantom turns while a view is exposed."""

import math

from sawmill_tomography.calibration.faults.effect import Effect
from sawmill_tomography.calibration.normal_equations import Column
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

# With fewer views a step is so large that two points of it do not stand for an exposure.
FEWEST_VIEWS = 60


def _columns(model: ScanModel) -> tuple[Column, ...]:
    return (Column.of(Term.EXPOSURE),) if len(model.data.angles_rad) >= FEWEST_VIEWS else ()


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    share = math.sqrt(max(float(sizes[0]), 0.0))
    return f"the phantom turns by {share:.0%} of a step while a view is exposed"


ROTATION_DURING_EXPOSURE = Effect(Adjustment.ROTATION_DURING_EXPOSURE, _columns, _sentence)
