"""Chart of a month of a scanner's movement, as small as a word."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

from sawmill_contracts.measurements import Movement
from sawmill_contracts.scanners import Tolerances

WIDTH, HEIGHT = 150, 40  # as drawn; the page may stretch it
_MARGIN = 4
_TALLEST = 1.6  # tolerances; larger movements are drawn at the top
_MOST = 60  # points: two a day


@dataclass(frozen=True)
class Sparkline:
    """Chart in units of the drawing, y downwards.

    Attributes
    ----------
    line : str
        Points of a polyline, the oldest first.
    last : tuple of float
        Newest point.
    tolerance_y : float
        Position of the tolerance.
    beyond : bool
        True if the newest point lies beyond the tolerance.
    checks : int
        Number of measurements.
    most_mm : float
        Largest movement.
    """

    line: str
    last: tuple[float, float]
    tolerance_y: float
    beyond: bool
    checks: int
    most_mm: float


def sparkline(
    movements: Iterable[Movement], tolerances: Tolerances, start: datetime, end: datetime
) -> Sparkline | None:
    """Draw the measurements that show a movement, from `start` to `end`; None where there is none."""
    seen = [each for each in movements if each.ray_change_mm is not None]
    if not seen:
        return None
    span_s = (end - start).total_seconds()
    points = [
        (
            round(_MARGIN + (WIDTH - 2 * _MARGIN) * min((each.at - start).total_seconds() / span_s, 1.0), 1),
            _y((each.ray_change_mm or 0.0) / (each.ray_change_tolerance_mm or tolerances.ray_change_mm)),
        )
        for each in _thinned(seen)
    ]
    return Sparkline(
        line=" ".join(f"{x:g},{y:g}" for x, y in points),
        last=points[-1],
        tolerance_y=_y(1.0),
        beyond=points[-1][1] < _y(1.0),
        checks=len(seen),
        most_mm=max(each.ray_change_mm or 0.0 for each in seen),
    )


def _thinned(movements: list[Movement]) -> list[Movement]:
    """Select at most sixty measurements: the farthest of each few neighbours, and the newest."""
    step = -(-len(movements) // _MOST)
    groups = [movements[first : first + step] for first in range(0, len(movements) - 1, step)]
    return [*(max(group[:step], key=lambda each: each.ray_change_mm or 0.0) for group in groups), movements[-1]]


def _y(share: float) -> float:
    return round(HEIGHT - _MARGIN - (HEIGHT - 2 * _MARGIN) * min(share, _TALLEST) / _TALLEST, 1)
