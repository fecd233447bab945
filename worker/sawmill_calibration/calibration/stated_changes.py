"""The uncertainty budget with stated changes of the phantom since it was measured."""

import math
from dataclasses import replace

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_tomography.statistics import TWO_SIDED_95
from sawmill_vocabulary.uncertainty import SOURCES


def with_stated_changes(result: CalibrationResult, **changes: tuple[float, float, float] | None) -> CalibrationResult:
    """Count changes of the phantom in the sum of the budget and in the scale's bound; they correct nothing.

    `moisture`, %, and `temperature`, degrees Celsius: when the phantom was measured, at the scan, and the standard
    uncertainty of the difference. The line's standard uncertainty contains the change (GUM, F.2.4.5).
    """
    lines = {line.source: line for line in result.uncertainty_budget}
    for source, (measured, scanned, uncertainty) in ((name, one) for name, one in changes.items() if one is not None):
        about = SOURCES[source]
        change = min(scanned, about.highest) - min(measured, about.highest)
        size = math.hypot(change, uncertainty)
        counted = replace(lines[source], counted_in="sum", rays_share_percent=0.0, change=change)
        lines[source] = replace(counted, standard_uncertainty=size, scale_percent=size * about.scale_by_unit)
    summed = [line for line in lines.values() if line.counted_in == "sum"]
    deviation = math.hypot(*(line.scale_percent for line in summed))
    for line in summed:
        lines[line.source] = replace(line, scale_share_percent=100.0 * (line.scale_percent / (deviation or 1.0)) ** 2)
    bound = TWO_SIDED_95 * deviation + (lines["aspect"].scale_percent if "aspect" in lines else 0.0)
    return result.model_copy(update={"uncertainty_budget": [*lines.values()], "scale_uncertainty_percent": bound})
