"""A drawing with rounded convex corners, as wear and saws make them."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Phantom, Polygon

ARC_POINTS = 7


# A joint fit needs the same drawing at every step.
@lru_cache(maxsize=4)
def with_rounded_corners(phantom: Phantom, radius_mm: float) -> Phantom:
    """Add pieces of negative density to every convex corner of the wood, so that arcs of this radius remain."""
    if radius_mm == 0.0:
        return phantom
    pieces = [
        Polygon(tuple(map(tuple, piece.tolist())), -shape.density)
        for shape in phantom.shapes
        if isinstance(shape, Polygon) and shape.density > 0.0
        for piece in _pieces(np.array(shape.vertices_mm), radius_mm)
    ]
    return replace(phantom, shapes=(*phantom.shapes, *pieces)) if pieces else phantom


def _pieces(corners: FloatArray, radius: float) -> list[FloatArray]:
    """Compute the pieces that the arcs cut off: polygons from a corner along one edge, and back along the arc."""
    x, y = corners[:, 0], corners[:, 1]
    sense = math.copysign(1.0, float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))
    pieces = []
    for before, corner, after in zip(np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0), strict=True):
        back, on = before - corner, after - corner
        if sense * (-back[0] * on[1] + back[1] * on[0]) <= 0.0:  # the wood turns inwards here
            continue
        a, b = back / np.hypot(*back), on / np.hypot(*on)
        half = 0.5 * math.acos(float(np.clip(a @ b, -1.0, 1.0)))
        reach = min(radius / math.tan(half), 0.45 * float(np.hypot(*back)), 0.45 * float(np.hypot(*on)))
        fitted = reach * math.tan(half)
        centre = corner + fitted / math.sin(half) * (a + b) / np.hypot(*(a + b))
        start, stop = corner + reach * a - centre, corner + reach * b - centre
        first = math.atan2(start[1], start[0])
        bends = first + math.remainder(math.atan2(stop[1], stop[0]) - first, 2.0 * math.pi) * np.linspace(
            0.0, 1.0, ARC_POINTS
        )
        arc = centre + fitted * np.stack([np.cos(bends), np.sin(bends)], -1)
        pieces.append(np.concatenate([corner[None], arc]))
    return pieces
