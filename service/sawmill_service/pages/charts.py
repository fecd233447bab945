"""Charts of months of measurements: panels over one axis of time, drawn as SVG by `chart_panels.html`.

Places along the time are in per cent of the panel's width, so that one drawing fits a telephone and a wall; places
across it are in pixels.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from sawmill_contracts.measurements import MeasurementKind, Movement
from sawmill_contracts.scanner_drift import PooledDrift
from sawmill_service.pages.pooled_lines import Together, Value, points, pooled_lines
from sawmill_worker.pictures.round_numbers import round_length, ticks

HEIGHT_PX, PAD_PX = 150, 14
# Beyond this number of measurements each part of the time keeps the extremes of each value alone.
MOST_MARKS, PARTS = 240, 40
DAY = timedelta(days=1)
STEPS = (
    *(hours * DAY / 24 for hours in (1, 2, 3, 6, 12)),
    *(days * DAY for days in (1, 2, 5, 10, 20, 30, 61, 91, 182)),
)
MOST_STEPS = 5


@dataclass(frozen=True)
class Mark:
    """One measurement in one panel.

    `beyond`: its value is larger than the panel shows. `faint`: a pooled line stands for it and others.
    """

    x: float
    y: float
    shape: str
    tone: str
    beyond: bool
    faint: bool = False


@dataclass(frozen=True)
class Panel:
    """One value over the time.

    Attributes
    ----------
    name : str
        Of its value.
    marks, line
        The measurements, and a line through them: `points` of SVG in a box of 100 x the height.
    ticks : list of (y, value), digits : int
        Round values beside it, and with how many decimals.
    tolerance_y : float or None
        Down to which the values are within tolerance.
    bars : str
        From where to where a value may lie: a path of SVG in the same box.
    pooled : list of (line, band)
        Of drift checks against one calibration by one method: `points` of SVG in the same box of what they measured
        together, and of where that lies with 95 %.
    zeros : list of (x, y)
        Where a baseline begins, and its value.
    height : int
        In pixels.
    """

    name: str
    marks: list[Mark]
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
    """Everything that its template draws.

    Attributes
    ----------
    panels : list of Panel
        One above the other.
    shown : list of (x, Movement)
        The measurements that are drawn, the oldest first.
    accepted : list of (x, calibration's id, time)
        When a calibration became the active one.
    days : list of (x, time)
        Where the axis has a date, or an hour.
    total : int
        Of the measurements in the span; those that are not shown lie between ones that are.
    alarms : list of (x, width)
        While one was open.
    changed : list of (x, start, width)
        When the scanner moved or began to, as its logs show together, and where that time lies with 95 %.
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
    """From when to when a chart reaches."""

    start: datetime
    end: datetime

    def x(self, at: datetime) -> float:
        """In per cent of the width; the ends keep free of marks."""
        return round(1.0 + 98.0 * ((at - self.start) / (self.end - self.start)), 2)


def thinned(
    movements: Sequence[Movement], span: Span, values: Collection[Value], *, parts: int = PARTS
) -> list[Movement]:
    """All of them or, of many, the first, the last, and those with an extreme of any value in each part of the span.

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
            known = [(number, one) for one in part if (number := value(one)) is not None]
            if known:
                kept |= {id(choose(known, key=lambda pair: pair[0])[1]) for choose in (min, max)}
    return [one for one in movements if id(one) in kept]


def panel_of(
    name: str,
    known: Sequence[tuple[float, float, Movement]],
    low: float,
    high: float,
    *,
    tolerance: float | None = None,
    bars: Iterable[tuple[float, float, float]] = (),
    together: Together | None = None,
    zeros: Iterable[tuple[float, float]] = (),
    height: int = HEIGHT_PX,
) -> Panel:
    """A panel from its lowest value to its highest.

    Parameters
    ----------
    name
        Of the value.
    known
        Places along the time, values, and whose they are.
    low, high
        What stands at the lower and the upper edge, and what is beyond stands there too.
    tolerance
        Up to which values are within tolerance; null: they have none.
    bars
        Places along the time, with the lowest and the highest that a value may be.
    together
        What drift checks measured together of the value; null: nothing.
    zeros
        Where baselines begin, and their values.
    height
        In pixels.
    """

    def y(number: float) -> float:
        share = (min(max(number, low), high) - low) / (high - low)
        return round(height - PAD_PX - share * (height - 2 * PAD_PX), 1)

    marks = [
        Mark(x, y(number), one.kind.value, _tone(one), number > high, faint=together is not None and together.has(one))
        for x, number, one in known
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
        pooled=[] if together is None else list(pooled_lines(together, known, y)),
        zeros=[(x, y(value)) for x, value in zeros],
        height=height,
    )


def zeros_of(charts: Iterable[PooledDrift], span: Span, together: Together | None) -> list[tuple[float, float]]:
    """Where the baselines of charts begin in a span, and what they are of a value; none of what has no baseline."""
    found = []
    for chart in charts:
        zero = None if together is None else together.zero(chart)
        if zero is not None and chart.baseline is not None and chart.baseline.first_at is not None:
            found.append((span.x(max(chart.baseline.first_at, span.start)), zero))
    return found


def changes_of(charts: Iterable[PooledDrift], span: Span) -> list[tuple[float, float, float]]:
    """When logs together show that the scanner moved, as `Chart.changed`."""
    found = []
    for each in (chart.alarm for chart in charts):
        if each is None or each.began_at is None or each.began_between is None or each.began_at < span.start:
            continue
        first, last = (span.x(max(at, span.start)) for at in each.began_between)
        found.append((span.x(each.began_at), first, round(last - first, 2)))
    return found


def range_of(numbers: Sequence[float], *, least: float) -> tuple[float, float]:
    """With room around it; `least` is that of values that are all the same, or nearly so."""
    if not numbers:
        return 0.0, 1.0
    low, high = min(numbers), max(numbers)
    # Of huge values alone, `least` would be lost in rounding.
    room = 0.1 * max(high - low, least, 1e-9 * max(-low, high))
    return low - room, high + room


def _digits(step: float) -> int:
    """Decimals that tell two neighbouring ticks apart."""
    return next(digits for digits in range(7) if round_length(step) >= 10.0**-digits * 0.999 or digits == 6)


def _tone(one: Movement) -> str:
    if one.within_tolerance is None:
        return "idle"
    return "good" if one.within_tolerance else "bad"


def days_of(span: Span) -> list[tuple[float, datetime]]:
    """Evenly spaced midnights, back from the newest; of a short span hours."""
    length = span.end - span.start
    step = next((step for step in STEPS if length / step <= MOST_STEPS), STEPS[-1])
    midnight = span.end.astimezone().replace(hour=0, minute=0, second=0, microsecond=0)
    at = midnight + (span.end - midnight) // step * step
    found = []
    while at >= span.start:
        found.append((span.x(at), at))
        at -= step
    return found[::-1]


def span_of(days: float, now: datetime) -> Span:
    """The last days up to now."""
    return Span(now - days * DAY, now)


def is_calibration(one: Movement) -> bool:
    """Whether a phantom was measured, and not a log."""
    return one.kind is MeasurementKind.CALIBRATION
