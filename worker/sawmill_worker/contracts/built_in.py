"""The two published phantoms (DESIGN section 3), outlines in mm."""

from collections.abc import Mapping
from types import MappingProxyType

from sawmill_worker.contracts.phantoms import DiscShape, PhantomDrawing, PolygonShape

_L_SHAPE = PhantomDrawing(
    name="L-shape",
    shapes=[
        PolygonShape(
            vertices_mm=[
                (-100.07, 51.52),
                (-0.14, 51.52),
                (-0.14, -150.04),
                (100.07, -150.04),
                (100.07, 150.88),
                (-100.07, 150.88),
            ]
        )
    ],
)
_RECTANGLE_WITH_HOLE = PhantomDrawing(
    name="Rectangle with hole",
    shapes=[
        PolygonShape(vertices_mm=[(-99.79, -150.04), (100.35, -150.04), (100.35, 150.32), (-99.79, 150.32)]),
        DiscShape(center_mm=(-50.0, -49.0), radius_mm=26.0, density=-1.0),
    ],
)

BUILT_IN_PHANTOMS: Mapping[str, PhantomDrawing] = MappingProxyType(
    {"l-shape": _L_SHAPE, "rectangle-with-hole": _RECTANGLE_WITH_HOLE}
)
