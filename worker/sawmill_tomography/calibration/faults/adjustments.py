"""Faults of a scan that are handled before the effects are fitted with the geometry."""

from collections.abc import Collection

from sawmill_tomography.calibration.faults.finding import AdjustedFit, EffectFinding
from sawmill_tomography.calibration.faults.intensity_averaging import INTENSITY_AVERAGING
from sawmill_tomography.calibration.faults.outliers import OUTLIERS
from sawmill_vocabulary import Adjustment

BEFORE: tuple[EffectFinding, ...] = (INTENSITY_AVERAGING, OUTLIERS)


def prepare(now: AdjustedFit, without: Collection[Adjustment] = ()) -> AdjustedFit:
    """Go from the plain fit to the one that effects are fitted from; faults in `without` are not looked for."""
    for finding in BEFORE:
        if finding.adjustment not in without:
            now = finding.adjust(now)
    return now
