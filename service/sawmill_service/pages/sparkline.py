"""A month of a scanner's movement, as small as a word."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

from sawmill_contracts.measurements import Movement
from sawmill_contracts.scanners import Tolerances

WIDTH, HEIGHT = 150, 40  # as drawn; the page may stretch it
_MARGIN = 4
_TALLEST = 1.6  # tolerances; what moved farther stands at the top
_MOST = 60  # points: two a day


@dataclass(frozen=True)
class Sparkline:
    """What the page draws, in the drawing's units, y downwards.

    Attributes
    ----------
    line : str
        The points of a polyline, the oldest first.
    last : tuple of float
        The newest point.
    tolerance_y : float
        Where the tolerance lies.
    beyond : bool
        Whether the newest point lies beyond it.
    checks : int
        How many measurements there are.
    most_mm : float
        The farthest of them.
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
    """Draw those that show a movement, from `start` to `end`; None where there is none."""
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
    """At most sixty: the farthest of each few neighbours, and the newest."""
    step = -(-len(movements) // _MOST)
    groups = [movements[first : first + step] for first in range(0, len(movements) - 1, step)]
    return [*(max(group[:step], key=lambda each: each.ray_change_mm or 0.0) for group in groups), movements[-1]]


def _y(share: float) -> float:
    return round(HEIGHT - _MARGIN - (HEIGHT - 2 * _MARGIN) * min(share, _TALLEST) / _TALLEST, 1)
