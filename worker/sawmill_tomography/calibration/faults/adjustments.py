"""Faults of a scan that are handled before the effects are fitted with the geometry."""

from collections.abc import Collection

from sawmill_tomography.calibration.faults.finding import AdjustedFit, EffectFinding
from sawmill_tomography.calibration.faults.intensity_averaging import INTENSITY_AVERAGING
from sawmill_tomography.calibration.faults.outliers import OUTLIERS
from sawmill_vocabulary import Adjustment

BEFORE: tuple[EffectFinding, ...] = (INTENSITY_AVERAGING, OUTLIERS)


def prepare(adjusted: AdjustedFit, without: Collection[Adjustment] = ()) -> AdjustedFit:
    """Adjust the plain fit to faults, as the start of the joint fit; faults in `without` are not searched."""
    for finding in BEFORE:
        if finding.adjustment not in without:
            adjusted = finding.adjust(adjusted)
    return adjusted
