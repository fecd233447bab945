"""The detector's response has changed across it since the flat fields were taken: a slope, and a curvature."""

from sawmill_tomography.calibration.faults.effect import Effect, terms
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


def _sentence(_: ScanModel, sizes: FloatArray) -> str:
    slope, curvature = sizes
    return (
        f"the flat field has changed across the detector, by {slope:+.2%} from end to end and {0.25 * curvature:+.2%} "
        "at both ends"
    )


FLAT_FIELD = Effect(
    Adjustment.FLAT_FIELD,
    terms(Term.SLOPE, Term.CURVATURE),
    _sentence,
    "take the flat fields anew, right before the scan",
)
