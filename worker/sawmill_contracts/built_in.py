"""The drawings of the two published phantoms."""

from collections.abc import Mapping
from types import MappingProxyType

from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_vocabulary import BUILT_IN_OUTLINES

_NAMES = {"l-shape": "L-shape", "rectangle-with-hole": "Rectangle with hole"}

BUILT_IN_PHANTOMS: Mapping[str, PhantomDrawing] = MappingProxyType(
    {
        phantom_id: PhantomDrawing(name=_NAMES[phantom_id], shapes=list(shapes))
        for phantom_id, shapes in BUILT_IN_OUTLINES.items()
    }
)
