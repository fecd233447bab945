"""The phantom is not its drawing by an affine change: wet across the grain, or not square to the axis."""

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    aspect, shear = sizes
    return f"the phantom is longer in x than in y against its drawing by {aspect:+.2%}, and sheared by {shear:+.2%}"


DEFORMATION = Effect(
    Adjustment.DEFORMATION,
    terms(Term.ASPECT, Term.SHEAR),
    _sentence,
    "measure both sides of the phantom, and check that it stands square to the axis",
)
