"""Shapes of phantoms, polygons and discs in mm, and the outlines of the two published phantoms."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, Literal

from annotated_types import Interval

from sawmill_vocabulary.geometry import LARGEST_MM
from sawmill_vocabulary.outlines import AsContract, described

# Relative standard uncertainty of a phantom's size where it is not stated. Spruce moves by 0.15 to 0.3 % across the
# grain for each per cent of moisture.
STANDARD_SIZE_TOLERANCE = 0.0015
# An axis of a phantom's drawing.
TrueAxis = Literal["x", "y"]
# Radius of the largest log where it is not stated: ray errors are counted further out only where a larger radius is
# stated.
LARGEST_ASSUMED_LOG_RADIUS_MM = 150.0
# Smallest disc that can be drawn, and least and largest density against wood's: the science squares these numbers. The
# contract states these bounds and checks a drawing in a request; earlier versions have stored other values.
SMALLEST_RADIUS_MM = 0.1
SMALLEST_DENSITY, LARGEST_DENSITY = 1e-6, 1000.0
# Most corners of a polygon.
MOST_CORNERS = 2000
_DENSITY = {
    "description": "Density that is added to the shapes before this one, no unit: 1 is wood, -1 cuts a hole into wood. "
    f"0, or at least {SMALLEST_DENSITY:g} in size.",
    "examples": [1.0],
    "json_schema_extra": {
        "minimum": -LARGEST_DENSITY,
        "maximum": LARGEST_DENSITY,
        "not": {
            "anyOf": [
                {"exclusiveMinimum": 0, "exclusiveMaximum": SMALLEST_DENSITY},
                {"exclusiveMinimum": -SMALLEST_DENSITY, "exclusiveMaximum": 0},
            ]
        },
    },
}


def _state_smallest_radius(schema: dict[str, Any]) -> None:
    del schema["exclusiveMinimum"]
    schema["minimum"] = SMALLEST_RADIUS_MM


CoordinateMm = Annotated[float, Interval(ge=-LARGEST_MM, le=LARGEST_MM)]
Point = tuple[CoordinateMm, CoordinateMm]


@dataclass(frozen=True)
class Polygon(AsContract):
    """A closed polygon; its vertices may run either way round."""

    kind: Literal["polygon"] = field(default="polygon", kw_only=True, metadata=described("Type of the shape."))
    vertices_mm: tuple[Point, ...] = field(
        metadata=described(
            "(x, y) of each corner, mm.",
            examples=[((-100, -150), (100, -150), (100, 150), (-100, 150))],
            min_length=3,
            max_length=MOST_CORNERS,
        )
    )
    density: float = field(default=1.0, metadata=_DENSITY)

    @property
    def area_mm2(self) -> float:
        """Enclosed area, mm²; 0 where the corners lie on one line."""
        (x0, y0), twice, xa, ya = self.vertices_mm[0], 0.0, 0.0, 0.0
        for x, y in self.vertices_mm:
            xb, yb = x - x0, y - y0
            twice += xa * yb - xb * ya
            xa, ya = xb, yb
        return 0.5 * abs(twice)

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Least x and y, largest x and y."""
        x, y = zip(*self.vertices_mm, strict=True)
        return min(x), min(y), max(x), max(y)


@dataclass(frozen=True)
class Disc(AsContract):
    """A disc."""

    kind: Literal["disc"] = field(default="disc", kw_only=True, metadata=described("Type of the shape."))
    center_mm: Point = field(metadata=described("(x, y) of the centre, mm.", examples=[(-50.0, -49.0)]))
    radius_mm: float = field(
        metadata=described(
            "Radius, mm.", examples=[26.0], gt=0, le=LARGEST_MM, json_schema_extra=_state_smallest_radius
        )
    )
    density: float = field(default=1.0, metadata=_DENSITY)

    @property
    def area_mm2(self) -> float:
        """Enclosed area, mm²."""
        return math.pi * self.radius_mm**2

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Least x and y, largest x and y."""
        (x, y), r = self.center_mm, self.radius_mm
        return x - r, y - r, x + r, y + r


Shape = Polygon | Disc

# Half the diagonal of a pixel of the published drawings, of 1417 x 1417 pixels on 400 mm.
PUBLISHED_PRECISION_MM = 0.2
# Outlines as published (arXiv 2206.14444): measured on the wood, not nominal. Nominal sizes cost 0.15 mm of ray error.
BUILT_IN_OUTLINES: Mapping[str, tuple[Shape, ...]] = MappingProxyType(
    {
        "l-shape": (
            Polygon(
                (
                    (-100.07, 51.52),
                    (-0.14, 51.52),
                    (-0.14, -150.04),
                    (100.07, -150.04),
                    (100.07, 150.88),
                    (-100.07, 150.88),
                )
            ),
        ),
        "rectangle-with-hole": (
            Polygon(((-99.79, -150.04), (100.35, -150.04), (100.35, 150.32), (-99.79, 150.32))),
            Disc((-50.0, -49.0), 26.0, -1.0),
        ),
    }
)
