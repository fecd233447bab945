"""The published phantoms' drawings (design page, section 3), in mm."""

from sawmill_worker.tomography.phantom import Disc, Phantom, Polygon

L_SHAPE = Phantom(
    "l-shape",
    (
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
)

RECTANGLE_WITH_HOLE = Phantom(
    "rectangle-with-hole",
    (
        Polygon(((-99.79, -150.04), (100.35, -150.04), (100.35, 150.32), (-99.79, 150.32))),
        Disc((-50.0, -49.0), 26.0, -1.0),
    ),
)

BUILT_IN = {phantom.name: phantom for phantom in (L_SHAPE, RECTANGLE_WITH_HOLE)}
