"""Charts of measurements over time, drawn as SVG by templates: panels over one axis of time, and a month as a line.

Positions along the time are in per cent of the panel's width, so that one drawing fits a telephone and a wall;
positions across it are in pixels.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from statistics import median

from sawmill_calibration.pictures.round_numbers import round_length, ticks
from sawmill_contracts import mill_events
from sawmill_contracts.alarms import Alarm
from sawmill_contracts.history import HistoryKind, HistoryMark
from sawmill_contracts.measurements import MeasurementKind, Movement
from sawmill_contracts.scanner_drift import PooledDrift
from sawmill_contracts.scanners import Tolerances

HEIGHT_PX, TREND_PX, PAD_PX = 150, 110, 14
# Beyond this number of measurements each part of the time keeps only the extremes of each value. The trend has five
# values, of which fewer parts leave as many marks.
MOST_MARKS, PARTS, TREND_PARTS = 240, 40, 24
DAY = timedelta(days=1)
STEPS = (
    *(hours * DAY / 24 for hours in (1, 2, 3, 6, 12)),
    *(days * DAY for days in (1, 2, 5, 10, 20, 30, 61, 91, 182)),
)
MOST_STEPS = 5
# Movements beyond this multiple of the tolerance are drawn at the upper edge: they must not flatten all others.
MOST_TOLERANCES = 4.0
# Activations are ticks below the panels where more lines would look like a hatching.
MOST_LINES = 60
# Standard deviations from the mean within which 95 % of a normal distribution lie.
DEVIATIONS = 2.0
# A small chart: size, margin, its upper edge in tolerances, and two points a day.
SMALL_PX, SMALL_MARGIN_PX, SMALL_TOLERANCES, SMALL_PARTS = (150, 40), 4, 1.6, 30

_TONES = {None: "idle", True: "good", False: "bad"}  # by whether a movement is within its tolerance
Value = Callable[[Movement], float | None]


@dataclass(frozen=True)
class PooledValue:
    """A value pooled from a drift check and those before it, its standard deviation, and the value of the baseline."""

    value: Value
    deviation: Value
    zero: Callable[[PooledDrift], float | None]


@dataclass(frozen=True)
class Quantity:
    """A value that a panel shows, its standard deviation, and what drift checks together say of it.

    `least` is the smallest change that fills the panel: values that differ by less are the same to a person.
    """

    value: Value
    least: float = 0.1
    deviation: Value = lambda _: None
    together: PooledValue | None = None

    def is_pooled(self, one: Movement) -> bool:
        """Return whether a pooled line represents a measurement and others."""
        return self.together is not None and self.together.value(one) is not None


def is_calibration(one: Movement) -> bool:
    """Return whether a phantom was measured, and not a log."""
    return one.kind is MeasurementKind.CALIBRATION


def _of_phantoms(value: Value) -> Value:
    """Restrict a value to phantoms: a log shows another quantity under that name, or hardly anything."""
    return lambda one: value(one) if is_calibration(one) else None


_COLUMN = PooledValue(
    lambda one: one.pooled_cor_column_mm,
    lambda one: one.pooled_cor_column_standard_deviation_mm,
    lambda chart: chart.baseline_cor_column_mm,
)
_TILT = PooledValue(
    lambda one: one.pooled_tilt_deg,
    lambda one: one.pooled_tilt_standard_deviation_deg,
    lambda chart: chart.baseline_tilt_deg,
)
DRIFT = {
    "rays": Quantity(lambda one: one.ray_change_mm),
    "cor": Quantity(lambda one: one.cor_column_mm, together=_COLUMN),
    "tilt": Quantity(lambda one: one.tilt_deg, together=_TILT),
}
TREND = {
    "cor": Quantity(lambda one: one.cor_column_mm, 0.1, lambda one: one.cor_column_standard_deviation_mm, _COLUMN),
    "tilt": Quantity(lambda one: one.tilt_deg, 0.05, lambda one: one.tilt_standard_deviation_deg, _TILT),
    "sdd": Quantity(
        _of_phantoms(lambda one: one.source_to_detector_mm),
        1.0,
        _of_phantoms(lambda one: one.source_to_detector_standard_deviation_mm),
    ),
    "residual": Quantity(_of_phantoms(lambda one: one.relative_residual), 0.002),
    "gain": Quantity(_of_phantoms(lambda one: one.gain), 0.0005),
}


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
    faint: bool


@dataclass(frozen=True)
class Panel:
    """A value over the time; `line`, `bars` and `pooled` are SVG in a box of 100 x the height."""

    name: str
    height: int
    marks: list[ChartMark]
    line: str  # through the marks that are not faint
    ticks: list[tuple[float, float]]  # (y, value) of round values
    digits: int  # decimals of the round values
    tolerance_y: float | None  # values below are within tolerance; None: there is no tolerance
    bars: str  # intervals in which a value lies with 95 %
    pooled: list[tuple[str, str]]  # for each calibration and method a line and its 95 % band
    zeros: list[tuple[float, float]]  # (x, y) of the starts of baselines


@dataclass(frozen=True)
class Chart:
    """Content of a chart, as its template draws it."""

    panels: list[Panel]
    shown: list[tuple[float, Movement]]  # the oldest first, each with its x
    accepted: list[tuple[float, str, datetime]]  # x, id and time of each calibration that became the active one
    days: list[tuple[float, datetime]]  # dates or hours on the axis
    total: int  # measurements in the span; those that are not shown lie between shown ones
    changed: list[tuple[float, float, float]]  # x, start and width (95 %) of each time at which the scanner moved
    alarms: list[tuple[float, float]] = field(default_factory=list)  # x and width of each period with an open alarm


@dataclass(frozen=True)
class Span:
    """Time span of a chart."""

    start: datetime
    end: datetime

    @classmethod
    def until(cls, now: datetime, days: float) -> "Span":
        """Return the last days up to now."""
        return cls(now - days * DAY, now)

    def x(self, at: datetime) -> float:
        """Return the position of a time, per cent of the width; the ends keep free of marks."""
        return round(1.0 + 98.0 * ((at - self.start) / (self.end - self.start)), 2)


@dataclass(frozen=True)
class Sparkline:
    """A month of a scanner's movement as small as a word: points of a line, the newest one, and the tolerance.

    `checks` is the number of measurements, `most_mm` the largest movement.
    """

    line: str
    last: tuple[float, float]
    tolerance_y: float
    beyond: bool
    checks: int
    most_mm: float


def drift_chart(
    movements: Sequence[Movement],
    activations: Iterable[tuple[str, datetime]],
    *,
    span: Span,
    tolerance_mm: float,
    total: int,
    together: Sequence[PooledDrift] = (),
) -> Chart:
    """Make the drift chart of a scanner: how far its rays moved, against the tolerance, with COR and tilt.

    `movements` are those in the span or, of very many, a selection of the `total`, the oldest first; `together` has the
    pooled results of the drift checks since the active calibration.
    """
    accepted = [(span.x(at), identifier, at) for identifier, at in activations if span.start <= at <= span.end]
    shown = [(span.x(one.at), one) for one in thinned(movements, span, _values(DRIFT))]
    panels = [_panel(name, each, shown, HEIGHT_PX, together, span, tolerance_mm) for name, each in DRIFT.items()]
    return Chart(panels, shown, accepted, days_of(span), total, list(_changes(together, span)))


def trend_chart(
    movements: Sequence[Movement],
    marks: Sequence[HistoryMark],
    opened: Iterable[Alarm],
    span: Span,
    total: int,
    together: Sequence[PooledDrift] = (),
) -> Chart:
    """Make the trend chart of a scanner: five values over months, with activations and alarms.

    `marks` are the activations and alarms in the span, the oldest first, and `opened` the open alarms; the others as
    for `drift_chart`.
    """
    activations = (mark for mark in marks if mark.kind is HistoryKind.ACTIVATION)
    accepted = [(span.x(mark.at), mark.subject_id, mark.at) for mark in activations]
    shown = [(span.x(one.at), one) for one in thinned(movements, span, _values(TREND), parts=TREND_PARTS)]
    panels = [_panel(name, each, shown, TREND_PX, together, span) for name, each in TREND.items()]
    changed, alarms = list(_changes(together, span)), _alarms(marks, opened, span)
    return Chart(panels, shown, accepted, days_of(span), total, changed, alarms)


def sparkline(movements: Iterable[Movement], tolerances: Tolerances, span: Span) -> Sparkline | None:
    """Draw the measurements of a span that show a movement; None where there is none."""
    seen = [each for each in movements if each.ray_change_mm is not None]
    if not seen:
        return None
    width, height = SMALL_PX

    def share(one: Movement) -> float:
        return (one.ray_change_mm or 0.0) / (one.ray_change_tolerance_mm or tolerances.ray_change_mm)

    def y(tolerance: float) -> float:
        inside = height - 2 * SMALL_MARGIN_PX
        return round(height - SMALL_MARGIN_PX - inside * min(tolerance, SMALL_TOLERANCES) / SMALL_TOLERANCES, 1)

    kept = thinned(seen, span, [share], parts=SMALL_PARTS, most=2 * SMALL_PARTS)
    places = [(round(width * span.x(each.at) / 100.0, 1), y(share(each))) for each in kept]
    most_mm = max(each.ray_change_mm or 0.0 for each in seen)
    return Sparkline(_points(places), places[-1], y(1.0), places[-1][1] < y(1.0), len(seen), most_mm)


def thinned(
    movements: Sequence[Movement], span: Span, values: Collection[Value], *, parts: int = PARTS, most: int = MOST_MARKS
) -> list[Movement]:
    """Select all measurements or, of more than `most`, the first, the last, and each part's extremes of each value.

    Calibrations stay where they are few.
    """
    if len(movements) <= most:
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


def range_of(numbers: Sequence[float], *, least: float) -> tuple[float, float]:
    """Return the range of the numbers with a tenth of it, at least a tenth of `least`, added at either end."""
    if not numbers:
        return 0.0, 1.0
    low, high = min(numbers), max(numbers)
    # With huge values, `least` would be lost in rounding.
    room = 0.1 * max(high - low, least, 1e-9 * max(-low, high))
    return low - room, high + room


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


def _values(quantities: dict[str, Quantity]) -> list[Value]:
    return [quantity.value for quantity in quantities.values()]


def _panel(
    name: str,
    quantity: Quantity,
    shown: Sequence[tuple[float, Movement]],
    height: int,
    together: Iterable[PooledDrift],
    span: Span,
    tolerance_mm: float | None = None,
) -> Panel:
    """Make the panel of a value; movement of the rays has a tolerance, and a panel from 0."""
    samples = [(x, value, one) for x, one in shown if (value := quantity.value(one)) is not None]
    zeros = list(_zeros(quantity.together, together, span))
    tolerance = tolerance_mm if name == "rays" else None
    bars = [
        (x, value - DEVIATIONS * deviation, value + DEVIATIONS * deviation)
        for x, value, one in samples
        if (deviation := quantity.deviation(one)) is not None and not quantity.is_pooled(one)
    ]
    numbers = [*(value for _, value, _ in samples), *(zero for _, zero in zeros)]
    if tolerance is not None:
        largest = max([1.25 * tolerance, *(1.05 * number for number in numbers)])
        low, high = 0.0, min(largest, MOST_TOLERANCES * tolerance)
    else:
        # A typical bar fits; a long bar ends at the edge, because it must not flatten all others.
        half = median([(upper - lower) / 2.0 for _, lower, upper in bars]) if bars else 0.0
        low, high = range_of([min(numbers) - half, max(numbers) + half] if numbers else [], least=quantity.least)

    def y(number: float) -> float:
        share = (min(max(number, low), high) - low) / (high - low)
        return round(height - PAD_PX - share * (height - 2 * PAD_PX), 1)

    marks = [
        ChartMark(x, y(number), one.kind.value, _TONES[one.within_tolerance], number > high, quantity.is_pooled(one))
        for x, number, one in samples
    ]
    values = ticks(low, high, 4 if height >= HEIGHT_PX else 3)
    step = round_length(values[1] - values[0] if len(values) > 1 else high - low)
    return Panel(
        name=name,
        height=height,
        marks=marks,
        line=_points((mark.x, mark.y) for mark in marks if not mark.faint),
        ticks=[(y(each), each) for each in values],
        digits=next((digits for digits in range(6) if step >= 10.0**-digits * 0.999), 6),
        tolerance_y=None if tolerance is None else y(tolerance),
        bars="".join(f"M{x} {y(lower)}V{y(upper)}" for x, lower, upper in bars),
        pooled=[] if quantity.together is None else list(_pooled(quantity.together, samples, y)),
        zeros=[(x, y(value)) for x, value in zeros],
    )


def _pooled(
    together: PooledValue, samples: Sequence[tuple[float, float, Movement]], y: Callable[[float], float]
) -> Iterator[tuple[str, str]]:
    """Yield for each calibration and method a line and the band around it."""
    by_chart: dict[tuple[str | None, str | None], list[tuple[float, float, float]]] = {}
    for x, _, one in samples:
        value, deviation = together.value(one), together.deviation(one)
        if value is not None and deviation is not None:
            by_chart.setdefault((one.against_id, one.method), []).append((x, value, DEVIATIONS * deviation))
    for places in by_chart.values():
        upper = [(x, y(value + half)) for x, value, half in places]
        lower = [(x, y(value - half)) for x, value, half in reversed(places)]
        yield _points((x, y(value)) for x, value, _ in places), _points([*upper, *lower])


def _zeros(pooled: PooledValue | None, charts: Iterable[PooledDrift], span: Span) -> Iterator[tuple[float, float]]:
    """Yield the starts of baselines in a span, with the value of each; charts without a baseline have none."""
    for chart in charts:
        zero = None if pooled is None else pooled.zero(chart)
        if zero is not None and chart.baseline is not None and chart.baseline.first_at is not None:
            yield span.x(max(chart.baseline.first_at, span.start)), zero


def _changes(charts: Iterable[PooledDrift], span: Span) -> Iterator[tuple[float, float, float]]:
    for each in (chart.alarm for chart in charts):
        if each is None or each.began_at is None or each.began_between is None or each.began_at < span.start:
            continue
        first, last = (span.x(max(at, span.start)) for at in each.began_between)
        yield span.x(each.began_at), first, round(last - first, 2)


def _alarms(marks: Iterable[HistoryMark], opened: Iterable[Alarm], span: Span) -> list[tuple[float, float]]:
    """Return position and width of each period with an open alarm; a period that began before the span is cut off."""
    since, periods = {}, []
    for mark in marks:
        if mark.type is mill_events.ALARM_OPENED:
            since[mark.alarm] = mark.at
        elif mark.type is mill_events.ALARM_CLOSED:
            periods.append((since.pop(mark.alarm, span.start), mark.at))
    periods += [(since.get(alarm.kind, span.start), span.end) for alarm in opened]
    return [(span.x(start), round(span.x(end) - span.x(start), 2)) for start, end in periods]


def _points(places: Iterable[tuple[float, float]]) -> str:
    """Write points as SVG has them."""
    return " ".join(f"{x:g},{y:g}" for x, y in places)
