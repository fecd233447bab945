"""The drift chart of a scanner's page: how far its rays moved, against the tolerance, with COR and tilt."""

from collections.abc import Iterable, Sequence
from datetime import datetime

from sawmill_contracts.measurements import Movement
from sawmill_contracts.scanner_drift import PooledDrift
from sawmill_service.pages.charts.charts import (
    Chart,
    Panel,
    Span,
    changes_of,
    days_of,
    panel_of,
    range_of,
    thinned,
    zeros_of,
)
from sawmill_service.pages.charts.pooled_lines import COLUMN, TILT, Value

# Values beyond this multiple of the tolerance are drawn at the upper edge: they must not flatten all others.
MOST_TOLERANCES = 4.0
DRIFT: dict[str, Value] = {
    "rays": lambda one: one.ray_change_mm,
    "cor": lambda one: one.cor_column_mm,
    "tilt": lambda one: one.tilt_deg,
}
POOLED_VALUES = {"cor": COLUMN, "tilt": TILT}


def drift_chart(
    movements: Sequence[Movement],
    activations: Iterable[tuple[str, datetime]],
    *,
    span: Span,
    tolerance_mm: float,
    total: int,
    together: Sequence[PooledDrift] = (),
) -> Chart:
    """Make the drift chart of one scanner.

    Parameters
    ----------
    movements
        Measurements in the span, the oldest first; a selection where there are very many.
    activations
        Ids of calibrations, and the times at which they became active.
    span
        Time span of the chart.
    tolerance_mm
        Movement of the rays that is allowed, mm.
    total
        Number of measurements in the span.
    together
        Pooled results of the drift checks since the active calibration, by method.
    """
    shown = [(span.x(one.at), one) for one in thinned(movements, span, DRIFT.values())]
    accepted = [(span.x(at), identifier, at) for identifier, at in activations if span.start <= at <= span.end]
    return Chart(
        panels=[
            _panel(name, value, shown, tolerance_mm, zeros_of(together, span, POOLED_VALUES.get(name)))
            for name, value in DRIFT.items()
        ],
        shown=shown,
        accepted=accepted,
        days=days_of(span),
        total=total,
        changed=changes_of(together, span),
    )


def _panel(
    name: str,
    value: Value,
    shown: Sequence[tuple[float, Movement]],
    tolerance_mm: float,
    zeros: Sequence[tuple[float, float]],
) -> Panel:
    samples = [(x, number, one) for x, one in shown if (number := value(one)) is not None]
    numbers = [number for _, number, _ in samples] + [zero for _, zero in zeros]
    if name == "rays":
        return panel_of(name, samples, *_range_of_rays(numbers, tolerance_mm), tolerance=tolerance_mm)
    return panel_of(name, samples, *range_of(numbers, least=0.1), together=POOLED_VALUES[name], zeros=zeros)


def _range_of_rays(numbers: Sequence[float], tolerance_mm: float) -> tuple[float, float]:
    largest = max([1.25 * tolerance_mm, *(1.05 * number for number in numbers)])
    return 0.0, min(largest, MOST_TOLERANCES * tolerance_mm)
