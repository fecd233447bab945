"""Lag: a view still shows some of the one before it."""

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    return f"a lag of the detector, of {sizes[0]:.1%} of the view before"


LAG = Effect(Adjustment.LAG, terms(Term.LAG, counts=True), _sentence)
