"""The uncertainty budget with stated changes of the phantom since it was measured: moisture and temperature."""

import math
from collections.abc import Mapping
from dataclasses import replace

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_tomography.calibration.scale import TWO_SIDED_95
from sawmill_vocabulary.uncertainty import SOURCES, StatedChange


def with_stated_changes(result: CalibrationResult, changes: Mapping[str, StatedChange]) -> CalibrationResult:
    """Count changes of the phantom in the sum of the budget and in the scale's bound; they correct nothing.

    `changes` are of `moisture`, %, and `temperature`, K. Standard uncertainties contain the change (GUM, F.2.4.5).
    """
    lines = {line.source: line for line in result.uncertainty_budget}
    for source, (measured, scanned, uncertainty) in changes.items():
        about = SOURCES[source]
        change = min(scanned, about.highest) - min(measured, about.highest)
        size = math.hypot(change, uncertainty)
        counted = replace(lines[source], counted_in="sum", rays_share_percent=0.0, change=change)
        lines[source] = replace(counted, standard_uncertainty=size, scale_percent=size * about.scale_by_unit)
    summed = {source: line.scale_percent**2 for source, line in lines.items() if line.counted_in == "sum"}
    variance, aspect = sum(summed.values()), lines["aspect"].scale_percent if "aspect" in lines else 0.0
    for source, own_variance in summed.items():
        share = 100.0 * own_variance / variance if variance else None
        lines[source] = replace(lines[source], scale_share_percent=share)
    bound = TWO_SIDED_95 * math.sqrt(variance) + aspect
    return result.model_copy(update={"uncertainty_budget": [*lines.values()], "scale_uncertainty_percent": bound})
