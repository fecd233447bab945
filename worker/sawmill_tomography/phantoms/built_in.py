"""The two published phantoms as bodies."""

from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import BUILT_IN_OUTLINES, PUBLISHED_PRECISION_MM

BUILT_IN = {
    name: Phantom(name, shapes, precision_mm=PUBLISHED_PRECISION_MM) for name, shapes in BUILT_IN_OUTLINES.items()
}
L_SHAPE, RECTANGLE_WITH_HOLE = BUILT_IN["l-shape"], BUILT_IN["rectangle-with-hole"]
