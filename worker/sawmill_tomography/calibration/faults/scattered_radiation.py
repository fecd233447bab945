"""Radiation that the phantom scatters into the cells: from around, and from the whole view."""

import numpy as np

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

# The share of samples above which a shadow is the deepest.
DEEPEST = 0.98


def _sentence(model: ScanModel, sizes: FloatArray) -> str:
    around, wide = model.halos
    deepest = model.blurred > np.quantile(model.blurred, DEEPEST)
    added = float((sizes[0] * around + sizes[1] * wide)[deepest].mean())
    return f"scattered radiation, which adds {added:.1%} to the intensity of the deepest shadow"


SCATTERED_RADIATION = Effect(
    Adjustment.SCATTERED_RADIATION, terms(Term.SCATTER, Term.SCATTER_WIDE, counts=True), _sentence
)
