"""A density that slopes over the wood, as with moisture."""

import math

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    return f"the wood's density slopes by {100.0 * math.hypot(*sizes):.1%} in 100 mm"


DENSITY_GRADIENT = Effect(Adjustment.DENSITY_GRADIENT, terms(Term.GRADIENT_X, Term.GRADIENT_Y), _sentence)
