"""The drift chart: months of measurements as three panels over one axis of time, drawn as SVG by its template.

Places along the time are in per cent of the panel's width, so that one drawing fits a telephone and a wall; places
across it are in pixels.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from sawmill_worker.contracts.measurements import MeasurementKind, Movement
from sawmill_worker.pictures.round_numbers import round_length, ticks

HEIGHT_PX, PAD_PX = 150, 14
# Values far beyond the tolerance stand at the upper edge: they must not flatten all others.
MOST_TOLERANCES = 4.0
# Beyond this number of measurements each part of the time keeps the extremes of each value alone.
MOST_MARKS, PARTS = 240, 40
DAY = timedelta(days=1)
DAY_STEPS = (1, 2, 5, 10, 20, 30, 61, 91, 182)
MOST_DAYS = 5

Value = Callable[[Movement], float | None]
VALUES: dict[str, Value] = {
    "rays": lambda one: one.ray_change_mm,
    "cor": lambda one: one.cor_column_mm,
    "tilt": lambda one: one.tilt_deg,
}


@dataclass(frozen=True)
class Mark:
    """One measurement in one panel; `beyond`: its value is larger than the panel shows."""

    x: float
    y: float
    shape: str
    tone: str
    beyond: bool


@dataclass(frozen=True)
class Panel:
    """One value over the time.

    Attributes
    ----------
    name : str
        A key of `VALUES`.
    marks, line
        The measurements, and a line through them: `points` of SVG in a box of 100 x the height.
    ticks : list of (y, value), digits : int
        Round values beside it, and with how many decimals.
    tolerance_y : float or None
        Down to which the values are within tolerance.
    """

    name: str
    marks: list[Mark]
    line: str
    ticks: list[tuple[float, float]]
    digits: int
    tolerance_y: float | None


@dataclass(frozen=True)
class Chart:
    """Everything that its template draws.

    Attributes
    ----------
    panels : list of Panel
        Rays, COR and tilt.
    shown : list of (x, Movement)
        The measurements that are drawn, the oldest first.
    accepted : list of (x, calibration's id, time)
        When a calibration became the active one.
    days : list of (x, time)
        Where the axis has a date.
    total : int
        Of the measurements in the span; those that are not shown lie between ones that are.
    """

    panels: list[Panel]
    shown: list[tuple[float, Movement]]
    accepted: list[tuple[float, str, datetime]]
    days: list[tuple[float, datetime]]
    total: int


@dataclass(frozen=True)
class Span:
    """From when to when a chart reaches."""

    start: datetime
    end: datetime

    def x(self, at: datetime) -> float:
        """In per cent of the width; the ends keep free of marks."""
        return round(1.0 + 98.0 * ((at - self.start) / (self.end - self.start)), 2)


def drift_chart(
    movements: Sequence[Movement],
    activations: Iterable[tuple[str, datetime]],
    *,
    span: Span,
    tolerance_mm: float,
) -> Chart:
    """The chart of one scanner.

    Parameters
    ----------
    movements
        In the span, the oldest first.
    activations
        Calibrations' ids and when they became the active one.
    span
        From when to when it reaches.
    tolerance_mm
        What the rays may move.
    """
    shown = [(span.x(one.at), one) for one in thinned(movements, span)]
    accepted = [(span.x(at), identifier, at) for identifier, at in activations if span.start <= at <= span.end]
    return Chart(
        panels=[_panel(name, shown, tolerance_mm) for name in VALUES],
        shown=shown,
        accepted=accepted,
        days=_days(span),
        total=len(movements),
    )


def thinned(movements: Sequence[Movement], span: Span) -> list[Movement]:
    """All of them or, of many, the first, the last, and those with an extreme of any value in each part of the span."""
    if len(movements) <= MOST_MARKS:
        return list(movements)
    parts: dict[int, list[Movement]] = {}
    for one in movements:
        parts.setdefault(int(PARTS * ((one.at - span.start) / (span.end - span.start))), []).append(one)
    kept = {id(movements[0]), id(movements[-1])}
    for part in parts.values():
        for value in VALUES.values():
            known = [(number, one) for one in part if (number := value(one)) is not None]
            if known:
                kept |= {id(choose(known, key=lambda pair: pair[0])[1]) for choose in (min, max)}
    return [one for one in movements if id(one) in kept]


def _panel(name: str, shown: Sequence[tuple[float, Movement]], tolerance_mm: float) -> Panel:
    value = VALUES[name]
    known = [(x, number, one) for x, one in shown if (number := value(one)) is not None]
    numbers = [number for _, number, _ in known]
    low, high = _range_of_rays(numbers, tolerance_mm) if name == "rays" else _range(numbers)

    def y(number: float) -> float:
        share = (min(max(number, low), high) - low) / (high - low)
        return round(HEIGHT_PX - PAD_PX - share * (HEIGHT_PX - 2 * PAD_PX), 1)

    marks = [Mark(x, y(number), one.kind.value, _tone(one), number > high) for x, number, one in known]
    values = ticks(low, high, 4)
    step = values[1] - values[0] if len(values) > 1 else high - low
    return Panel(
        name=name,
        marks=marks,
        line=" ".join(f"{mark.x},{mark.y}" for mark in marks),
        ticks=[(y(each), each) for each in values],
        digits=_digits(step),
        tolerance_y=y(tolerance_mm) if name == "rays" else None,
    )


def _range_of_rays(numbers: Sequence[float], tolerance_mm: float) -> tuple[float, float]:
    largest = max([1.25 * tolerance_mm, *(1.05 * number for number in numbers)])
    return 0.0, min(largest, MOST_TOLERANCES * tolerance_mm)


def _range(numbers: Sequence[float]) -> tuple[float, float]:
    """With room around it, for a value that hardly changes as well."""
    if not numbers:
        return 0.0, 1.0
    low, high = min(numbers), max(numbers)
    room = max(0.1 * (high - low), 0.01)
    return low - room, high + room


def _digits(step: float) -> int:
    """Decimals that tell two neighbouring ticks apart."""
    return next(digits for digits in range(7) if round_length(step) >= 10.0**-digits * 0.999 or digits == 6)


def _tone(one: Movement) -> str:
    if one.within_tolerance is None:
        return "idle"
    return "good" if one.within_tolerance else "bad"


def _days(span: Span) -> list[tuple[float, datetime]]:
    """Evenly spaced midnights, back from the newest."""
    length = span.end - span.start
    step = next((step for step in DAY_STEPS if length / (step * DAY) <= MOST_DAYS), DAY_STEPS[-1])
    day = span.end.astimezone().replace(hour=0, minute=0, second=0, microsecond=0)
    found = []
    while day >= span.start:
        found.append((span.x(day), day))
        day -= step * DAY
    return found[::-1]


def span_of(days: int, now: datetime) -> Span:
    """The last days up to now."""
    return Span(now - days * DAY, now)


def is_calibration(one: Movement) -> bool:
    """Whether a phantom was measured, and not a log."""
    return one.kind is MeasurementKind.CALIBRATION
