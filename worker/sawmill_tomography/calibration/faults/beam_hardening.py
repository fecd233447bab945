"""Beam hardening: the measured line integral is p + c p^2 + d p^3."""

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _sentence(model: ScanModel, sizes: FloatArray) -> str:
    longest = float(model.lengths.max())
    change = sizes[0] * longest + sizes[1] * longest**2
    return f"beam hardening of {change:+.1%} on the longest path"


BEAM_HARDENING = Effect(Adjustment.BEAM_HARDENING, terms(Term.HARDENING, Term.HARDENING_CUBIC), _sentence)
