"""The focal spot and the scintillator blur along the detector: a Gaussian."""

import math

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    return f"a blur of {math.sqrt(max(sizes[0], 0.0)):.2f} detector cells (standard deviation)"


BLUR = Effect(Adjustment.BLUR, terms(Term.BLUR), _sentence)
