"""Check that a closed polygon is an outline: every corner once, no side across another.

The sweep of Shamos and Hoey (1976) stops at the first crossing: O(n log n) comparisons. A sweep line
moves from left to right over the corners; sides that cross are neighbours along it before it has passed their
crossing. Corners of one x are taken from below, as if the line leant by a trace.

`AsContract` is the base of all values that contracts take as fields; `described` gives a field its words and bounds.
"""

from collections.abc import Sequence
from typing import ClassVar

Corner = tuple[float, float]


def fault_of_outline(corners: Sequence[Corner]) -> str | None:
    """Find what is wrong with a polygon, as the predicate of a sentence; None where its sides enclose one area.

    The sentence counts corners and sides from 1, as the drawing of a phantom does.
    """
    first_by_corner: dict[Corner, int] = {}
    for number, corner in enumerate(corners):
        first = first_by_corner.setdefault(corner, number)
        if first != number:
            at = f"({corner[0]:g}, {corner[1]:g})"
            return f"has the corner {at} twice, as corners {first + 1} and {number + 1}: give each corner once"
    crossing = _Sweep(corners).first_crossing()
    if crossing is None:
        return None
    count = len(corners)
    one, other = (f"{side + 1} (corner {side + 1} to {(side + 1) % count + 1})" for side in sorted(crossing))
    return f"crosses itself: side {one} meets side {other}; give the corners in their order around the outline"


class _Sweep:
    """The sides by their number, each from its left end to its right one."""

    def __init__(self, corners: Sequence[Corner]) -> None:
        self._corners, self._count = corners, len(corners)
        self._sides = [(a, b) if a < b else (b, a) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
        # Numbers of the sides that the sweep line meets, from below.
        self._met: list[int] = []

    def first_crossing(self) -> tuple[int, int] | None:
        for corner in sorted(range(self._count), key=self._corners.__getitem__):
            crossing = self._turned_back(corner) or self._passed(corner)
            if crossing is not None:
                return crossing
        return None

    def _turned_back(self, corner: int) -> tuple[int, int] | None:
        """Return the sides at a corner, where the second runs back along the first."""
        x, y = self._corners[corner]
        (ax, ay), (bx, by) = self._corners[corner - 1], self._corners[(corner + 1) % self._count]
        back = (ax - x) * (bx - x) + (ay - y) * (by - y) > 0.0
        return self._at(corner) if back and _turn((ax, ay), (x, y), (bx, by)) == 0.0 else None

    def _at(self, corner: int) -> tuple[int, int]:
        return (corner - 1) % self._count, corner

    def _passed(self, corner: int) -> tuple[int, int] | None:
        """Move the line over a corner; return the crossing that this shows."""
        point, met = self._corners[corner], self._met
        begun = [side for side in self._at(corner) if self._sides[side][0] == point]
        ended = [side for side in self._at(corner) if self._sides[side][0] != point]
        places = sorted(met.index(side) for side in ended)
        place = places[0] if places else self._place(point)
        if len(places) == 2 and places[1] != place + 1:
            return met[place], met[place + 1]
        if len(begun) == 2 and _turn(point, self._sides[begun[0]][1], self._sides[begun[1]][1]) < 0.0:
            begun.reverse()
        met[place : place + len(ended)] = begun
        return self._meeting(place - 1, place) or (
            self._meeting(place + len(begun) - 1, place + len(begun)) if begun else None
        )

    def _place(self, point: Corner) -> int:
        """Count the sides below the point."""
        low, high = 0, len(self._met)
        while low < high:
            middle = (low + high) // 2
            left_end, right_end = self._sides[self._met[middle]]
            low, high = (middle + 1, high) if _turn(left_end, right_end, point) > 0.0 else (low, middle)
        return low

    def _meeting(self, below: int, above: int) -> tuple[int, int] | None:
        """Return the sides at two neighbouring places, where they share a point that is no corner of both."""
        if below < 0 or above >= len(self._met):
            return None
        one, other = self._met[below], self._met[above]
        if (one - other) % self._count in {1, self._count - 1}:
            return None
        return (one, other) if _share_a_point(self._sides[one], self._sides[other]) else None


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    """Return twice the area of the triangle, positive where c is left of the way from a to b."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _share_a_point(one: tuple[Corner, Corner], other: tuple[Corner, Corner]) -> bool:
    """Return whether two sides, each from left to right, cross or touch."""
    if max(one[0][0], other[0][0]) > min(one[1][0], other[1][0]):
        return False
    if max(min(one[0][1], one[1][1]), min(other[0][1], other[1][1])) > min(
        max(one[0][1], one[1][1]), max(other[0][1], other[1][1])
    ):
        return False
    return _turn(*one, other[0]) * _turn(*one, other[1]) <= 0.0 and _turn(*other, one[0]) * _turn(*other, one[1]) <= 0.0


class AsContract:
    """A dataclass that pydantic reads as it reads a contract, with the bounds in the metadata of its fields.

    Unknown fields and numbers that are not finite are refused, and an instance is checked again.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid", "allow_inf_nan": False, "revalidate_instances": "always"}


def described(description: str, **bounds: object) -> dict[str, object]:
    """Return the metadata of a field: its description, and examples and bounds as pydantic names them."""
    return {"description": description, **bounds}
