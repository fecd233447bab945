"""Corners that are rounded, by wear or the saw."""

import math

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    return f"corners rounded by {math.sqrt(max(float(sizes[0]), 0.0)):.1f} mm (radius)"


CORNERS = Effect(Adjustment.CORNERS, terms(Term.CORNERS), _sentence)
