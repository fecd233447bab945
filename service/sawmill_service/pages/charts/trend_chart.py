"""Chart of calibrations and drift checks of a scanner: five values over months, with alarms and activations."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from sawmill_contracts import mill_events
from sawmill_contracts.alarms import Alarm
from sawmill_contracts.history import HistoryKind, HistoryMark
from sawmill_contracts.measurements import Movement
from sawmill_contracts.scanner_drift import PooledDrift
from sawmill_service.pages.charts.charts import (
    Chart,
    Panel,
    Span,
    changes_of,
    days_of,
    is_calibration,
    panel_of,
    range_of,
    thinned,
    zeros_of,
)
from sawmill_service.pages.charts.pooled_lines import COLUMN, DEVIATIONS, TILT, PooledValue, Value

# Two extremes of five values in each part leave as many marks as the drift chart has.
PARTS = 24
HEIGHT_PX = 110
# More lines would look like a hatching.
MOST_LINES = 60


@dataclass(frozen=True)
class Quantity:
    """A value that a panel shows.

    Attributes
    ----------
    value, deviation
        Value of a measurement, and its standard deviation.
    together
        Pooled results of drift checks for the value; None: there are none.
    least : float
        Smallest change that fills the panel: values that differ by less are the same to a person.
    """

    value: Value
    least: float
    deviation: Value = lambda _: None
    together: PooledValue | None = None


def _of_phantoms(value: Value) -> Value:
    """Restrict a value to phantoms: a log shows another quantity under that name, or hardly anything."""
    return lambda one: value(one) if is_calibration(one) else None


QUANTITIES = {
    "cor": Quantity(lambda one: one.cor_column_mm, 0.1, lambda one: one.cor_column_standard_deviation_mm, COLUMN),
    "tilt": Quantity(lambda one: one.tilt_deg, 0.05, lambda one: one.tilt_standard_deviation_deg, TILT),
    "sdd": Quantity(
        _of_phantoms(lambda one: one.source_to_detector_mm),
        1.0,
        _of_phantoms(lambda one: one.source_to_detector_standard_deviation_mm),
    ),
    "residual": Quantity(_of_phantoms(lambda one: one.relative_residual), 0.002),
    "gain": Quantity(_of_phantoms(lambda one: one.gain), 0.0005),
}


def trend_chart(
    movements: Sequence[Movement],
    marks: Iterable[HistoryMark],
    opened: Iterable[Alarm],
    span: Span,
    total: int,
    together: Sequence[PooledDrift] = (),
) -> Chart:
    """Make the trend chart of one scanner.

    Parameters
    ----------
    movements
        Measurements in the span, the oldest first; a selection where there are very many.
    marks
        Activations and alarms in the span, the oldest first.
    opened
        Open alarms.
    span
        Time span of the chart.
    total
        Number of measurements in the span.
    together
        Pooled results of the drift checks since the active calibration, by method.
    """
    marks = list(marks)
    values = [quantity.value for quantity in QUANTITIES.values()]
    shown = [(span.x(one.at), one) for one in thinned(movements, span, values, parts=PARTS)]
    activations = [mark for mark in marks if mark.kind is HistoryKind.ACTIVATION]
    return Chart(
        panels=[
            _panel(name, quantity, shown, zeros_of(together, span, quantity.together))
            for name, quantity in QUANTITIES.items()
        ],
        shown=shown,
        accepted=[(span.x(mark.at), mark.subject_id, mark.at) for mark in activations],
        days=days_of(span),
        total=total,
        alarms=_alarms(marks, opened, span),
        changed=changes_of(together, span),
    )


def _panel(
    name: str, quantity: Quantity, shown: Sequence[tuple[float, Movement]], zeros: Sequence[tuple[float, float]]
) -> Panel:
    samples = [(x, value, one) for x, one in shown if (value := quantity.value(one)) is not None]
    bars = [
        (x, value - DEVIATIONS * deviation, value + DEVIATIONS * deviation)
        for x, value, one in samples
        if (deviation := quantity.deviation(one)) is not None
        and (quantity.together is None or not quantity.together.has(one))
    ]
    # A typical bar fits; a long bar ends at the edge, because it must not flatten all others.
    half = median([(high - low) / 2.0 for _, low, high in bars]) if bars else 0.0
    values = [value for _, value, _ in samples] + [zero for _, zero in zeros]
    reached = [min(values) - half, max(values) + half] if values else []
    low, high = range_of(reached, least=quantity.least)
    return panel_of(name, samples, low, high, bars=bars, together=quantity.together, zeros=zeros, height=HEIGHT_PX)


def _alarms(marks: Iterable[HistoryMark], opened: Iterable[Alarm], span: Span) -> list[tuple[float, float]]:
    """Return position and width of each period with an open alarm; a period that began before the span is cut off."""
    since, periods = {}, []
    for mark in marks:
        if mark.what is mill_events.ALARM_OPENED:
            since[mark.alarm] = mark.at
        elif mark.what is mill_events.ALARM_CLOSED:
            periods.append((since.pop(mark.alarm, span.start), mark.at))
    periods += [(since.get(alarm.what, span.start), span.end) for alarm in opened]
    return [(span.x(start), round(span.x(end) - span.x(start), 2)) for start, end in periods]
