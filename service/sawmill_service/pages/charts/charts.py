"""Charts of months of measurements: panels over one axis of time, drawn as SVG by `chart_panels.html`.

Positions along the time are in per cent of the panel's width, so that one drawing fits a telephone and a wall;
positions across it are in pixels.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from sawmill_contracts.measurements import MeasurementKind, Movement
from sawmill_contracts.scanner_drift import PooledDrift
from sawmill_service.pages.charts.pooled_lines import PooledValue, Value, points, pooled_lines
from sawmill_worker.pictures.round_numbers import round_length, ticks

HEIGHT_PX, PAD_PX = 150, 14
# Beyond this number of measurements each part of the time keeps only the extremes of each value.
MOST_MARKS, PARTS = 240, 40
DAY = timedelta(days=1)
STEPS = (
    *(hours * DAY / 24 for hours in (1, 2, 3, 6, 12)),
    *(days * DAY for days in (1, 2, 5, 10, 20, 30, 61, 91, 182)),
)
MOST_STEPS = 5


@dataclass(frozen=True)
class ChartMark:
    """A measurement in a panel.

    `beyond`: its value is larger than the panel shows. `faint`: a pooled line represents this and other measurements.
    """

    x: float
    y: float
    shape: str
    tone: str
    beyond: bool
    faint: bool = False


@dataclass(frozen=True)
class Panel:
    """A value over the time.

    Attributes
    ----------
    name : str
        Name of the value.
    marks, line
        Measurements, and a line through them: `points` of SVG in a box of 100 x the height.
    ticks : list of (y, value), digits : int
        Round values next to the panel, and the number of their decimals.
    tolerance_y : float or None
        Position of the tolerance, below which values are within tolerance; None: there is no tolerance.
    bars : str
        Intervals in which a value may lie: a path of SVG in the same box.
    pooled : list of (line, band)
        Pooled values of the drift checks against one calibration by one method, and the band in which these lie with
        95 %: `points` of SVG in the same box.
    zeros : list of (x, y)
        Starts of baselines, and their values.
    height : int
        Height, pixels.
    """

    name: str
    marks: list[ChartMark]
    line: str
    ticks: list[tuple[float, float]]
    digits: int
    tolerance_y: float | None
    bars: str = ""
    pooled: Sequence[tuple[str, str]] = ()
    zeros: Sequence[tuple[float, float]] = ()
    height: int = HEIGHT_PX


@dataclass(frozen=True)
class Chart:
    """Content of a chart, as its template draws it.

    Attributes
    ----------
    panels : list of Panel
        Panels, one above the other.
    shown : list of (x, Movement)
        Measurements that are drawn, the oldest first.
    accepted : list of (x, calibration's id, time)
        Times at which a calibration became the active one.
    days : list of (x, time)
        Dates or hours on the axis.
    total : int
        Number of measurements in the span; those that are not shown lie between shown ones.
    alarms : list of (x, width)
        Periods with an open alarm.
    changed : list of (x, start, width)
        Times at which the scanner moved or began to, as its logs together show, and the 95 % intervals of these times.
    """

    panels: list[Panel]
    shown: list[tuple[float, Movement]]
    accepted: list[tuple[float, str, datetime]]
    days: list[tuple[float, datetime]]
    total: int
    alarms: Sequence[tuple[float, float]] = ()
    changed: Sequence[tuple[float, float, float]] = ()


@dataclass(frozen=True)
class Span:
    """Time span of a chart."""

    start: datetime
    end: datetime

    def x(self, at: datetime) -> float:
        """Return the position of a time, per cent of the width; the ends keep free of marks."""
        return round(1.0 + 98.0 * ((at - self.start) / (self.end - self.start)), 2)


def thinned(
    movements: Sequence[Movement], span: Span, values: Collection[Value], *, parts: int = PARTS
) -> list[Movement]:
    """Select all measurements or, of many, the first, the last, and the extremes of each value in parts of the span.

    Calibrations stay where they are few.
    """
    if len(movements) <= MOST_MARKS:
        return list(movements)
    by_part: dict[int, list[Movement]] = {}
    for one in movements:
        by_part.setdefault(int(parts * ((one.at - span.start) / (span.end - span.start))), []).append(one)
    calibrations = [id(one) for one in movements if is_calibration(one)]
    kept = {id(movements[0]), id(movements[-1]), *(calibrations if len(calibrations) <= PARTS else ())}
    for part in by_part.values():
        for value in values:
            numbers = [(number, one) for one in part if (number := value(one)) is not None]
            if numbers:
                kept |= {id(choose(numbers, key=lambda pair: pair[0])[1]) for choose in (min, max)}
    return [one for one in movements if id(one) in kept]


def panel_of(
    name: str,
    samples: Sequence[tuple[float, float, Movement]],
    low: float,
    high: float,
    *,
    tolerance: float | None = None,
    bars: Iterable[tuple[float, float, float]] = (),
    together: PooledValue | None = None,
    zeros: Iterable[tuple[float, float]] = (),
    height: int = HEIGHT_PX,
) -> Panel:
    """Make a panel from its lowest value to its highest.

    Parameters
    ----------
    name
        Name of the value.
    samples
        Positions along the time, values, and their measurements.
    low, high
        Values at the lower and the upper edge; values beyond are drawn at the edge.
    tolerance
        Largest value that is within tolerance; None: there is no tolerance.
    bars
        Positions along the time, with the lowest and the highest possible value.
    together
        Pooled results of drift checks for the value; None: there are none.
    zeros
        Starts of baselines, and their values.
    height
        Height, pixels.
    """

    def y(number: float) -> float:
        share = (min(max(number, low), high) - low) / (high - low)
        return round(height - PAD_PX - share * (height - 2 * PAD_PX), 1)

    marks = [
        ChartMark(
            x, y(number), one.kind.value, _tone(one), number > high, faint=together is not None and together.has(one)
        )
        for x, number, one in samples
    ]
    values = ticks(low, high, 4 if height >= HEIGHT_PX else 3)
    step = values[1] - values[0] if len(values) > 1 else high - low
    return Panel(
        name=name,
        marks=marks,
        line=points((mark.x, mark.y) for mark in marks if not mark.faint),
        ticks=[(y(each), each) for each in values],
        digits=_digits(step),
        tolerance_y=None if tolerance is None else y(tolerance),
        bars="".join(f"M{x} {y(lowest)}V{y(highest)}" for x, lowest, highest in bars),
        pooled=[] if together is None else list(pooled_lines(together, samples, y)),
        zeros=[(x, y(value)) for x, value in zeros],
        height=height,
    )


def zeros_of(charts: Iterable[PooledDrift], span: Span, together: PooledValue | None) -> list[tuple[float, float]]:
    """Return the starts of baselines in a span, with the value of each; charts without a baseline have none."""
    zeros = []
    for chart in charts:
        zero = None if together is None else together.zero(chart)
        if zero is not None and chart.baseline is not None and chart.baseline.first_at is not None:
            zeros.append((span.x(max(chart.baseline.first_at, span.start)), zero))
    return zeros


def changes_of(charts: Iterable[PooledDrift], span: Span) -> list[tuple[float, float, float]]:
    """Return the times at which logs together show that the scanner moved, as in `Chart.changed`."""
    changes = []
    for each in (chart.alarm for chart in charts):
        if each is None or each.began_at is None or each.began_between is None or each.began_at < span.start:
            continue
        first, last = (span.x(max(at, span.start)) for at in each.began_between)
        changes.append((span.x(each.began_at), first, round(last - first, 2)))
    return changes


def range_of(numbers: Sequence[float], *, least: float) -> tuple[float, float]:
    """Return the range of the numbers with a tenth of it, at least a tenth of `least`, added at either end."""
    if not numbers:
        return 0.0, 1.0
    low, high = min(numbers), max(numbers)
    # With huge values, `least` would be lost in rounding.
    room = 0.1 * max(high - low, least, 1e-9 * max(-low, high))
    return low - room, high + room


def _digits(step: float) -> int:
    """Return the number of decimals that distinguishes two neighbouring ticks."""
    return next(digits for digits in range(7) if round_length(step) >= 10.0**-digits * 0.999 or digits == 6)


def _tone(one: Movement) -> str:
    if one.within_tolerance is None:
        return "idle"
    return "good" if one.within_tolerance else "bad"


def days_of(span: Span) -> list[tuple[float, datetime]]:
    """Return evenly spaced midnights with their positions, counted back from the newest; for a short span hours."""
    length = span.end - span.start
    step = next((step for step in STEPS if length / step <= MOST_STEPS), STEPS[-1])
    midnight = span.end.astimezone().replace(hour=0, minute=0, second=0, microsecond=0)
    at = midnight + (span.end - midnight) // step * step
    days = []
    while at >= span.start:
        days.append((span.x(at), at))
        at -= step
    return days[::-1]


def span_of(days: float, now: datetime) -> Span:
    """Return the span of the last days up to now."""
    return Span(now - days * DAY, now)


def is_calibration(one: Movement) -> bool:
    """Return whether a phantom was measured, and not a log."""
    return one.kind is MeasurementKind.CALIBRATION
